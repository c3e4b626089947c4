import * as THREE from "three";
import type { Look, Samples, SideLook } from "./look_source";
import type { Texture } from "./texture_source";

/** Squares of sRGB pixels, the lowest row first, as layers. */
export function layeredTexture({ size, layers, pixels }: Texture): THREE.DataArrayTexture {
  const texture = new THREE.DataArrayTexture(pixels, size, size, layers);
  texture.colorSpace = THREE.SRGBColorSpace;
  texture.wrapS = texture.wrapT = THREE.RepeatWrapping;
  texture.minFilter = THREE.LinearMipmapLinearFilter;
  texture.magFilter = THREE.LinearFilter;
  texture.generateMipmaps = true;
  texture.anisotropy = 4;
  texture.needsUpdate = true;
  return texture;
}

function volumeTexture({ size, samples }: Samples, filter: THREE.MagnificationTextureFilter): THREE.Data3DTexture {
  const texture = new THREE.Data3DTexture(samples, ...size);
  texture.format = THREE.RedFormat;
  texture.minFilter = texture.magFilter = filter;
  texture.unpackAlignment = 1; // rows are not padded
  texture.needsUpdate = true;
  return texture;
}

function matrixOf({ fromRest: m }: Samples): THREE.Matrix4 {
  return new THREE.Matrix4().set(m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8], m[9], m[10], m[11], 0, 0, 0, 1);
}

const kPainted = 0.42; // colours are to look as they are in even light; the lights here are brighter
const linear = ({ colour: [r, g, b] }: SideLook) =>
  new THREE.Color().setRGB(r, g, b, THREE.SRGBColorSpace).multiplyScalar(kPainted).toArray();

/** The uniforms of the body's shader that say how its regions look, and the volume image in it. */
export class BodyLook {
  readonly uniforms = {
    uImage: { value: null as THREE.Data3DTexture | null },
    uImageFromRest: { value: new THREE.Matrix4() },
    uRegions: { value: null as THREE.Data3DTexture | null },
    uRegionsFromRest: { value: new THREE.Matrix4() },
    uLooks: { value: null as THREE.DataTexture | null }, // a row a region: inside colour, roughness; pattern, vessels, rim, layer; surface colour, roughness; layer
    uRegionTextures: { value: null as THREE.DataArrayTexture | null },
  };

  get hasImage(): boolean {
    return this.uniforms.uImage.value !== null;
  }
  get hasRegions(): boolean {
    return this.uniforms.uLooks.value !== null;
  }
  get hasRegionImage(): boolean {
    return this.uniforms.uRegions.value !== null;
  }
  get hasTextures(): boolean {
    return this.uniforms.uRegionTextures.value !== null;
  }

  set(look: Look): void {
    const u = this.uniforms;
    for (const uniform of [u.uImage, u.uRegions, u.uLooks, u.uRegionTextures]) {
      uniform.value?.dispose();
      uniform.value = null;
    }
    if (look.image) {
      u.uImage.value = volumeTexture(look.image, THREE.LinearFilter);
      u.uImageFromRest.value = matrixOf(look.image);
    }
    if (look.regionImage) {
      u.uRegions.value = volumeTexture(look.regionImage, THREE.NearestFilter);
      u.uRegionsFromRest.value = matrixOf(look.regionImage);
    }
    if (look.textures) u.uRegionTextures.value = layeredTexture(look.textures);
    if (look.regions.length === 0) return;
    const rows = look.regions.flatMap(({ surface, inside }) => [
      ...[...linear(inside), inside.roughness],
      ...[inside.pattern, inside.vessels, inside.rim, inside.layer],
      ...[...linear(surface), surface.roughness],
      ...[surface.layer, 0, 0, 0],
    ]);
    const looks = new THREE.DataTexture(
      Float32Array.from(rows),
      4,
      look.regions.length,
      THREE.RGBAFormat,
      THREE.FloatType,
    );
    looks.needsUpdate = true;
    u.uLooks.value = looks;
  }
}
