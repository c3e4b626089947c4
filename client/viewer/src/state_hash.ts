// The state hash (protocol/PROTOCOL.md, section 6) of surface triangles and vertices, in 32-bit arithmetic.

export const kSurfaceTriangle = 3;
export const kSurfaceVertex = 4;

const rotl = (x: number, n: number) => (x << n) | (x >>> (32 - n));

function mix(h: number): number {
  h ^= h >>> 16;
  h = Math.imul(h, 0x85ebca6b);
  h ^= h >>> 13;
  h = Math.imul(h, 0xc2b2ae35);
  return h ^ (h >>> 16);
}

/** The XOR of the hashes of elements: adding an element a second time takes it out. */
export class StateHash {
  private low = 0;
  private high = 0;

  /** words: 32-bit integers, signed or not. */
  toggle(kind: number, words: ArrayLike<number>, count: number): void {
    let a = Math.imul(kind, 0x9e3779b1);
    let b = Math.imul(~kind, 0x85ebca77);
    for (let i = 0; i < count; ++i) {
      const w = words[i];
      a = (Math.imul(rotl(a ^ Math.imul(w, 0xcc9e2d51), 13), 5) + 0xe6546b64) | 0;
      b = (Math.imul(rotl(b ^ Math.imul(w, 0x1b873593), 17), 9) + 0x38495ab5) | 0;
    }
    const low = mix(a ^ rotl(b, 7));
    this.low ^= low;
    this.high ^= mix((b + low) | 0);
  }

  clear(): void {
    this.low = this.high = 0;
  }

  get value(): bigint {
    return (BigInt(this.high >>> 0) << 32n) | BigInt(this.low >>> 0);
  }
}

export function hex(hash: bigint): string {
  return hash.toString(16).padStart(16, "0");
}
