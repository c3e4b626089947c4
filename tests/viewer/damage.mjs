// A line between page and server that damages one message.

import { connect, createServer } from "node:net";
import { load } from "./unit/modules.mjs";

const { Body, ByteBuffer, Message, SurfaceDelta } = await load(
  "wire/incise/wire/body",
  "wire/incise/wire/message",
  "wire/incise/wire/surface-delta",
  "../node_modules/flatbuffers",
);

/** Moves a vertex of a SurfaceDelta, in place. False: it is another message, or moves none. */
function damage(bytes) {
  const aligned = Uint8Array.from(bytes);
  const buffer = new ByteBuffer(aligned);
  if (!Message.bufferHasIdentifier(buffer)) return false;
  const message = Message.getRootAsMessage(buffer);
  if (message.bodyType() !== Body.SurfaceDelta) return false;
  const positions = message.body(new SurfaceDelta()).vertices()?.positionsArray();
  if (!positions?.length) return false;
  positions[0] += 0.001;
  bytes.set(aligned);
  return true;
}

/** Splits what a server sends into WebSocket frames (RFC 6455, section 5.2; a server's are not masked) after its HTTP answer. */
class Frames {
  pending = Buffer.alloc(0);
  upgraded = false;

  /** Calls back with the payload of each binary frame that is whole; returns the bytes to pass on. */
  take(chunk, visit) {
    this.pending = Buffer.concat([this.pending, chunk]);
    const out = [];
    for (let size = this.next(); size > 0 && size <= this.pending.length; size = this.next()) {
      const frame = Buffer.from(this.pending.subarray(0, size));
      this.pending = this.pending.subarray(size);
      if (this.upgraded && (frame[0] & 0x0f) === 2) visit(frame.subarray(this.headerOf(frame)));
      if (!this.upgraded) this.upgraded = true;
      out.push(frame);
    }
    return Buffer.concat(out);
  }

  headerOf(frame) {
    const length = frame[1] & 0x7f;
    return length === 127 ? 10 : length === 126 ? 4 : 2;
  }

  /** The size of what comes next; 0: not known yet. */
  next() {
    const { pending } = this;
    if (!this.upgraded) {
      const end = pending.indexOf("\r\n\r\n");
      return end < 0 ? 0 : end + 4;
    }
    if (pending.length < 2 || pending.length < this.headerOf(pending)) return 0;
    const length = pending[1] & 0x7f;
    if (length === 127) return 10 + Number(pending.readBigUInt64BE(2));
    return length === 126 ? 4 + pending.readUInt16BE(2) : 2 + length;
  }
}

/** The server's page at another address, through a line that damages one delta once it is armed. */
export async function damageOneDelta(t, server) {
  let armed = false;
  let done = false;
  const sockets = new Set();
  const line = createServer((client) => {
    const upstream = connect(server.ports.http_port, "127.0.0.1");
    const frames = new Frames();
    let isStream = false;
    client.on("data", (chunk) => {
      isStream ||= chunk.toString("latin1").startsWith("GET /ws");
      upstream.write(chunk);
    });
    upstream.on("data", (chunk) => {
      if (!isStream) return client.write(chunk);
      client.write(
        frames.take(chunk, (payload) => {
          if (armed && !done) done = damage(payload);
        }),
      );
    });
    for (const [from, to] of [
      [client, upstream],
      [upstream, client],
    ]) {
      sockets.add(from);
      from.on("close", () => to.destroy()).on("error", () => to.destroy());
    }
  });
  await new Promise((listening) => line.listen(0, "127.0.0.1", listening));
  t.after(() => {
    for (const socket of sockets) socket.destroy();
    line.close();
  });
  return { url: `http://127.0.0.1:${line.address().port}/`, arm: () => (armed = true), done: () => done };
}
