import * as THREE from "three";
import { GLTFExporter } from "three/addons/exporters/GLTFExporter.js";
import type { BodyMesh } from "./body_mesh";

// Loaded only when it is asked for: the exporter is no part of the page's first picture.

/** The colours of tissue in body_shader.ts, between dark and bright. */
const kSkin = { name: "skin", color: new THREE.Color(0.138, 0.024, 0.018), roughness: 0.45, metalness: 0 };
const kCut = { name: "cut", color: new THREE.Color(0.43, 0.112, 0.082), roughness: 0.35, metalness: 0 };

const kFirstTextured = 2; // in the list of materials; before: kSkin, kCut

/** Corners that have the same place, normal and texture coordinates become one vertex. */
class Vertices {
  readonly positions: number[] = [];
  readonly normals: number[] = [];
  readonly uvs: number[] = [];
  private readonly known = new Map<string, number>();

  add(position: Float32Array, normal: Int16Array, u: number, v: number): number {
    const key = `${position.join()},${normal.join()},${u},${v}`;
    let vertex = this.known.get(key);
    if (vertex === undefined) {
      this.known.set(key, (vertex = this.known.size));
      this.positions.push(...position);
      const length = Math.hypot(...normal) || 1;
      this.normals.push(...Array.from(normal, (x) => x / length));
      this.uvs.push(u, 1 - v); // an image's first row is at 0
    }
    return vertex;
  }
}

interface Piece {
  vertices: Vertices;
  parts: Map<number, number[]>; // three vertices a triangle, by material
}

/** The body's triangles, not opened, by the row of their piece. */
function piecesOf(body: BodyMesh): Map<number, Piece> {
  const attribute = (name: string) => body.mesh.geometry.getAttribute(name)?.array;
  const positions = attribute("position") as Float32Array,
    normals = attribute("aNormal") as Int16Array,
    facts = attribute("aFacts"),
    texture = attribute("aTexture") as Float32Array | undefined; // u, v, layer; -1: none
  const { corners } = body.shown(0);
  const triangle = new Float64Array(9);
  const pieces = new Map<number, Piece>();
  for (let slot = 0; slot < body.slots; ++slot) {
    if (!corners(slot, triangle)) continue;
    const row = facts[12 * slot + 2] + 256 * facts[12 * slot + 3];
    if (!pieces.has(row)) pieces.set(row, { vertices: new Vertices(), parts: new Map() });
    const { vertices, parts } = pieces.get(row)!;
    const layer = texture && !facts[12 * slot] ? Math.round(texture[9 * slot + 2]) : -1;
    const material = facts[12 * slot] ? 1 : layer < 0 ? 0 : kFirstTextured + layer;
    if (!parts.has(material)) parts.set(material, []);
    for (let c = 3 * slot; c < 3 * slot + 3; ++c) {
      const [u, v] = layer < 0 ? [0, 0] : [texture![3 * c], texture![3 * c + 1]];
      const at = vertices.add(positions.subarray(3 * c, 3 * c + 3), normals.subarray(4 * c, 4 * c + 3), u, v);
      parts.get(material)!.push(at);
    }
  }
  return pieces;
}

function meshOf({ vertices, parts }: Piece, materials: THREE.Material[]): THREE.Mesh {
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.Float32BufferAttribute(vertices.positions, 3));
  geometry.setAttribute("normal", new THREE.Float32BufferAttribute(vertices.normals, 3));
  const used = [...parts].sort(([a], [b]) => a - b);
  if (used.some(([material]) => material >= kFirstTextured))
    geometry.setAttribute("uv", new THREE.Float32BufferAttribute(vertices.uvs, 2));
  geometry.setIndex(used.flatMap(([, corners]) => corners));
  if (used.length === 1) return new THREE.Mesh(geometry, materials[used[0][0]]);
  let begin = 0;
  for (const [material, corners] of used) {
    geometry.addGroup(begin, corners.length, material);
    begin += corners.length;
  }
  return new THREE.Mesh(geometry, materials);
}

/** The layers of the body's texture as materials. */
function texturedMaterials(body: BodyMesh): THREE.Material[] {
  const array: THREE.DataArrayTexture | null = body.mesh.material.defines.TEXTURE ? body.uniforms.uTexture.value : null;
  if (!array) return [];
  const { width: size, depth, data } = array.image;
  const row = 4 * size;
  return Array.from({ length: depth }, (_, layer) => {
    const pixels = new Uint8Array(row * size);
    const from = layer * pixels.length;
    for (let y = 0; y < size; ++y)
      pixels.set(data!.subarray(from + y * row, from + (y + 1) * row) as Uint8Array, (size - 1 - y) * row); // the highest first
    const map = new THREE.DataTexture(pixels, size, size);
    map.colorSpace = THREE.SRGBColorSpace;
    map.wrapS = map.wrapT = THREE.RepeatWrapping;
    map.magFilter = THREE.LinearFilter;
    map.minFilter = THREE.LinearMipmapLinearFilter;
    return new THREE.MeshStandardMaterial({ name: `texture_${layer + 1}`, map, roughness: 0.6, metalness: 0 });
  });
}

/** The surface as it is, as binary glTF: a node for each piece, metres. */
export async function toGlb(body: BodyMesh, name: string): Promise<ArrayBuffer> {
  const plain = [kSkin, kCut].map((look) => new THREE.MeshStandardMaterial(look));
  const materials = [...plain, ...texturedMaterials(body)];
  const root = new THREE.Group();
  root.name = name;
  root.rotation.x = -Math.PI / 2; // glTF has y up, the mesh has z up
  let n = 0;
  for (const [, piece] of [...piecesOf(body)].sort(([a], [b]) => a - b)) {
    const mesh = meshOf(piece, materials);
    mesh.name = `piece_${++n}`;
    root.add(mesh);
  }
  return (await new GLTFExporter().parseAsync(root, { binary: true })) as ArrayBuffer;
}
