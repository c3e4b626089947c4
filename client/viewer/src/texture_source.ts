import { type Material, SurfaceAsset } from "./surface_asset";

const kLargest = 4096; // pixels a side, of one texture; of several, which are as large as each other, the next
const kLargestOfMany = 1024;
const kMostLayers = 64;

export interface Texture {
  size: number;
  layers: number;
  pixels: Uint8Array<ArrayBuffer>;
}

/** Where the HTTP port answers, by the address of its WebSocket. */
export function httpAddress(socketUrl: string): string {
  const url = new URL(socketUrl);
  return `${url.protocol === "wss:" ? "https:" : "http:"}//${url.host}`;
}

/** Where a document of the body's is, by its path: "/surface/0.png". */
export type DocumentAt = (path: string) => string;

/** Of a server; or of the folder of a session in this browser, whose files have no folders: "surface_0.png". */
export function documentsOf(sessionUrl: string): DocumentAt {
  return /^wss?:/.test(sessionUrl)
    ? (path) => httpAddress(sessionUrl) + path
    : (path) => sessionUrl + path.slice(1).replaceAll("/", "_");
}

export async function get(url: string, token: string): Promise<Response> {
  const answer = await fetch(url, token ? { headers: { Authorization: `Bearer ${token}` } } : {});
  if (!answer.ok) throw new Error(`${url}: ${answer.status}`);
  return answer;
}

/** null: the answer is no image that this browser can decode. Throws where there is no answer. */
export async function fetchImage(url: string, token: string): Promise<ImageBitmap | null> {
  const bytes = await (await get(url, token)).blob();
  try {
    return await createImageBitmap(bytes);
  } catch {
    return null;
  }
}

/**
 * The asset and its texture, and the names of images that cannot be decoded, whose materials have their plain colour;
 * null where none of its materials has an image, or it has no texture coordinates. Throws.
 */
export async function fetchTexture(
  at: DocumentAt,
  path: string,
  token: string,
): Promise<{ asset: SurfaceAsset; texture: Texture; undecoded: string[] } | null> {
  const asset = new SurfaceAsset(new Uint8Array(await (await get(at(path), token)).arrayBuffer()));
  if (asset.uvs.length === 0 || !asset.materials.some((m) => m.texture)) return null;
  const images = await Promise.all(
    asset.materials.map((m) => (m.texture ? fetchImage(at(`${path}/${m.texture}`), token) : null)),
  );
  const undecoded = asset.materials.filter((m, i) => m.texture && !images[i]).map((m) => `${path}/${m.texture}`);
  return { asset, texture: layersOf(asset.materials, images), undecoded };
}

/** All layers are squares of one size: a texture array has no other. */
export function layersOf(materials: Pick<Material, "diffuse">[], images: (ImageBitmap | null)[]): Texture {
  const layers = Math.min(materials.length, kMostLayers);
  const largest = Math.max(...images.map((i) => (i ? Math.max(i.width, i.height) : 1)));
  const size = Math.min(largest, layers === 1 ? kLargest : kLargestOfMany);
  const pixels = new Uint8Array(4 * size * size * layers);
  const context = new OffscreenCanvas(size, size).getContext("2d", { willReadFrequently: true })!;
  for (let i = 0; i < layers; ++i) {
    const image = images[i];
    context.setTransform(1, 0, 0, -1, 0, size); // v is upwards
    if (image) {
      context.drawImage(image, 0, 0, size, size);
      image.close();
    } else {
      context.fillStyle = `rgb(${materials[i].diffuse.map((x) => Math.round(255 * x)).join()})`;
      context.fillRect(0, 0, size, size);
    }
    pixels.set(context.getImageData(0, 0, size, size).data, 4 * size * size * i);
  }
  return { size, layers, pixels };
}
