import * as THREE from "three";
import { GLTFExporter } from "three/addons/exporters/GLTFExporter.js";
import type { BodyMesh } from "./body_mesh";

// Loaded only when it is asked for: the exporter is no part of the page's first picture.

/** The colours of tissue in body_shader.ts, between dark and bright. */
const kSkin = { name: "skin", color: new THREE.Color(0.138, 0.024, 0.018), roughness: 0.45, metalness: 0 };
const kCut = { name: "cut", color: new THREE.Color(0.43, 0.112, 0.082), roughness: 0.35, metalness: 0 };

/** Corners that have the same place and normal become one vertex. */
class Vertices {
  readonly positions: number[] = [];
  readonly normals: number[] = [];
  private readonly known = new Map<string, number>();

  add(position: Float32Array, normal: Int16Array): number {
    const key = `${position.join()},${normal.join()}`;
    let vertex = this.known.get(key);
    if (vertex === undefined) {
      this.known.set(key, (vertex = this.known.size));
      this.positions.push(...position);
      const length = Math.hypot(...normal) || 1;
      this.normals.push(...Array.from(normal, (x) => x / length));
    }
    return vertex;
  }
}

interface Piece {
  vertices: Vertices;
  skin: number[]; // three vertices a triangle
  cut: number[];
}

/** The body's triangles, not opened, by the row of their piece. */
function piecesOf(body: BodyMesh): Map<number, Piece> {
  const attribute = (name: string) => body.mesh.geometry.getAttribute(name).array;
  const positions = attribute("position") as Float32Array,
    normals = attribute("aNormal") as Int16Array,
    facts = attribute("aFacts");
  const { corners } = body.shown(0);
  const triangle = new Float64Array(9);
  const pieces = new Map<number, Piece>();
  for (let slot = 0; slot < body.slots; ++slot) {
    if (!corners(slot, triangle)) continue;
    const row = facts[12 * slot + 2] + 256 * facts[12 * slot + 3];
    if (!pieces.has(row)) pieces.set(row, { vertices: new Vertices(), skin: [], cut: [] });
    const { vertices, skin, cut } = pieces.get(row)!;
    for (let c = 3 * slot; c < 3 * slot + 3; ++c) {
      const vertex = vertices.add(positions.subarray(3 * c, 3 * c + 3), normals.subarray(4 * c, 4 * c + 3));
      (facts[12 * slot] ? cut : skin).push(vertex);
    }
  }
  return pieces;
}

function meshOf({ vertices, skin, cut }: Piece, materials: THREE.Material[]): THREE.Mesh {
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.Float32BufferAttribute(vertices.positions, 3));
  geometry.setAttribute("normal", new THREE.Float32BufferAttribute(vertices.normals, 3));
  geometry.setIndex([...skin, ...cut]);
  if (cut.length === 0) return new THREE.Mesh(geometry, materials[0]);
  if (skin.length === 0) return new THREE.Mesh(geometry, materials[1]);
  geometry.addGroup(0, skin.length, 0);
  geometry.addGroup(skin.length, cut.length, 1);
  return new THREE.Mesh(geometry, materials);
}

/** The surface as it is, as binary glTF: a node for each piece, metres. */
export async function toGlb(body: BodyMesh, name: string): Promise<ArrayBuffer> {
  const materials = [kSkin, kCut].map((look) => new THREE.MeshStandardMaterial(look));
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
