import type { Vec3 } from "./messages";
import { type DocumentAt, fetchImage, get, layersOf, type Texture } from "./texture_source";

/** An image of a byte a sample, x fastest. */
export interface Samples {
  size: Vec3;
  /** 12 numbers, three rows of four: from a place in the body at rest to 0 ... 1 along each axis of the image. */
  fromRest: number[];
  samples: Uint8Array<ArrayBuffer>;
}

export interface SideLook {
  colour: Vec3; // sRGB
  roughness: number;
  layer: number; // of Look.textures; -1: none
}

export const kPatterns = ["plain", "lobules", "fibres", "globules", "pores"] as const;

export interface RegionLook {
  region: number;
  surface: SideLook;
  inside: SideLook & { pattern: number; vessels: number; rim: number };
}

/** How the body looks, as its server says (PROTOCOL.md, section 5). */
export interface Look {
  image: Samples | null;
  regions: RegionLook[]; // empty: the page's own look
  regionImage: Samples | null; // which of `regions` a place is; 255: outside
  textures: Texture | null;
  undecoded: string[]; // paths of textures that are no image: plain colours stand for them
}

type Json = Record<string, unknown>;

function numbers(value: unknown, count: number): number[] {
  if (!Array.isArray(value) || value.length !== count || !value.every((x) => Number.isFinite(x)))
    throw new Error("a list of numbers is missing");
  return value as number[];
}

const vec3 = (value: unknown): Vec3 => numbers(value, 3) as Vec3;
const share = (value: unknown): number => numbers([value], 1)[0];

async function samplesOf(json: Json | undefined, at: DocumentAt, token: string): Promise<Samples | null> {
  if (!json) return null;
  const size = vec3(json.size);
  const answer = await get(at(String(json.path)), token);
  // A file server that knows the ending .gz may have had the browser unpack it.
  const bytes = new Uint8Array(await answer.arrayBuffer());
  const packed = bytes[0] === 0x1f && bytes[1] === 0x8b && bytes.length !== size[0] * size[1] * size[2];
  const samples = packed
    ? new Uint8Array(
        await new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"))).arrayBuffer(),
      )
    : bytes;
  if (samples.length !== size[0] * size[1] * size[2]) throw new Error(`${json.path} has ${samples.length} samples`);
  return { size, fromRest: numbers(json.texture_from_rest, 12), samples };
}

function sideOf(json: Json, layers: Map<string, number>): SideLook {
  const texture = String(json.texture ?? "");
  if (texture && !layers.has(texture)) layers.set(texture, layers.size);
  return { colour: vec3(json.colour), roughness: share(json.roughness), layer: texture ? layers.get(texture)! : -1 };
}

/** What the server says; null where it says nothing, as older ones do. Throws where it cannot be used. */
export async function fetchLook(
  at: DocumentAt,
  token: string,
): Promise<{ text: string; load: () => Promise<Look> } | null> {
  let text: string;
  try {
    text = await (await get(at("/look.json"), token)).text();
  } catch {
    return null;
  }
  return { text, load: () => loadLook(JSON.parse(text) as Json, at, token) };
}

async function loadLook(json: Json, at: DocumentAt, token: string): Promise<Look> {
  const layers = new Map<string, number>();
  const regions = ((json.regions ?? []) as Json[]).map((entry): RegionLook => {
    const inside = entry.inside as Json;
    return {
      region: share(entry.region),
      surface: sideOf(entry.surface as Json, layers),
      inside: {
        ...sideOf(inside, layers),
        pattern: Math.max(0, kPatterns.indexOf(inside.pattern as (typeof kPatterns)[number])),
        vessels: share(inside.vessels),
        rim: share(inside.fat_rim),
      },
    };
  });
  const [image, regionImage, images] = await Promise.all([
    samplesOf(json.image as Json | undefined, at, token),
    samplesOf(json.region_image as Json | undefined, at, token),
    Promise.all([...layers.keys()].map((path) => fetchImage(at(path), token))),
  ]);
  const undecoded = [...layers.keys()].filter((_, i) => !images[i]);
  const whole = images.filter((bitmap) => bitmap !== null);
  const layerOf = images.map((bitmap) => (bitmap ? whole.indexOf(bitmap) : -1));
  for (const side of regions.flatMap((r) => [r.surface, r.inside]))
    if (side.layer >= 0) side.layer = layerOf[side.layer];
  const white: Vec3 = [1, 1, 1];
  const textures =
    whole.length > 0
      ? layersOf(
          whole.map(() => ({ diffuse: white })),
          whole,
        )
      : null;
  return { image, regions, regionImage, textures, undecoded };
}
