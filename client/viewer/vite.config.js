import { createReadStream, createWriteStream, readdirSync, statSync } from "node:fs";
import { join } from "node:path";
import { pipeline } from "node:stream/promises";
import { createGzip } from "node:zlib";
import { defineConfig } from "vite";

// incised sends NAME.gz in place of NAME to a browser that takes gzip: the page's library is a fifth then.
function compressed() {
  let directory;
  return {
    name: "compressed",
    apply: "build",
    configResolved(config) {
      directory = config.build.outDir;
    },
    async closeBundle() {
      for (const entry of readdirSync(directory, { recursive: true })) {
        const path = join(directory, entry);
        if (!/\.(html|js|css|svg)$/.test(entry) || statSync(path).size < 1024) continue;
        await pipeline(createReadStream(path), createGzip({ level: 9 }), createWriteStream(`${path}.gz`));
      }
    },
  };
}

export default defineConfig({
  base: "./",
  build: { target: "es2022", emptyOutDir: true, chunkSizeWarningLimit: 2000, modulePreload: { polyfill: false } },
  worker: { format: "es" },
  plugins: [compressed()],
  // `npm run dev` gets the stream from an incised that runs on this machine.
  server: {
    proxy: {
      "/ws": { target: "ws://127.0.0.1:7480", ws: true, changeOrigin: true },
      "/stats": "http://127.0.0.1:7480",
      "/captures": "http://127.0.0.1:7480",
    },
  },
});
