// One pass, few instructions: without a graphics card the processor runs it. What a picture does not need is left out
// when the shader is compiled (COLOURING, WIRE, INSIDE, SECTION, DETAIL, TEXTURE, REST, IMAGE, REGIONS: body_mesh.ts), since a software renderer runs
// every branch of an `if` for every pixel: half of a frame's time went into colours that were not shown. Wet tissue is
// three things here: light that wraps around (it scatters below the skin), a broad and a sharp highlight, and a grain
// in its colour.

export const bodyVertexShader = /* glsl */ `
  precision highp float;
  out float vCoarse;
  in vec4 aNormal;
  in vec4 aFacts;  // cut face, quality, row of the piece (low, high)
  in vec3 aLips;
  uniform float uOpen;
  uniform vec3 uHeldAt, uHeldAlong;  // a line along which nothing is opened
  uniform vec4 uHeld;                // up to this distance; lips and pieces are from these on; 0: there is no such line
  uniform sampler2D uPieces;
  out vec3 vNormal;
  out vec3 vRest;
  out vec3 vWorld;
#if WIRE
  out vec3 vEdge;
#endif
  flat out vec3 vFacts;  // cut face, quality, row
  out float vDepth;  // below the skin, on a cut face: 0 to 1
#if REST
  in vec3 aRest;
#endif
#if INSIDE
  out vec3 vShift;  // from where a place is seen to where it is in the body at rest
#endif
#if REGIONS
  in float aRegion;
  flat out float vRegion;
#endif
#if TEXTURE
  in vec3 aTexture;  // u, v, layer
  out vec3 vTexture;
#endif

  void main() {
    int row = int(aFacts.z + 256.0 * aFacts.w + 0.5);
    vec3 apart = texelFetch(uPieces, ivec2(row & 255, row >> 8), 0).xyz;
    vec3 aside = position - uHeldAt;
    float away = length(aside - dot(aside, uHeldAlong) * uHeldAlong);
    vec2 open = uOpen * (1.0 - uHeld.w * (1.0 - smoothstep(uHeld.xx, uHeld.yz, vec2(away))));
    vec3 shown = position + open.x * aLips + open.y * apart;
#if WIRE
    int corner = gl_VertexID % 3;
    vEdge = vec3(corner == 0, corner == 1, corner == 2);
#endif
    vFacts = vec3(aFacts.x, aFacts.y / 255.0, float(row));
    vDepth = (aFacts.x - 1.0) / 254.0;
#if TEXTURE
    vTexture = aTexture;
#endif
    vNormal = aNormal.xyz;
#if REST
    vRest = aRest;
#else
    vRest = position;
#endif
#if INSIDE
    // Without the lips, which only move what is near them.
    vShift = vRest - position - open.y * apart;
#endif
#if REGIONS
    vRegion = aRegion;
#endif
    vCoarse = aNormal.w;
    vWorld = shown;
    gl_Position = projectionMatrix * viewMatrix * vec4(shown, 1.0);
  }
`;

export const bodyFragmentShader = /* glsl */ `
  precision highp float;
  in vec3 vNormal;
  in float vCoarse;
  in vec3 vRest;
  in vec3 vWorld;
#if WIRE
  in vec3 vEdge;
#endif
  flat in vec3 vFacts;
  in float vDepth;
#if INSIDE
  in vec3 vShift;
#endif
#if IMAGE
  precision highp sampler3D;
  uniform sampler3D uImage;
  uniform mat4 uImageFromRest;
#endif
#if REGIONS
  flat in float vRegion;
  uniform sampler2D uLooks;
#endif
#if REGION_IMAGE
  uniform highp sampler3D uRegions;
  uniform mat4 uRegionsFromRest;
#endif
#if REGION_TEXTURES
  uniform highp sampler2DArray uRegionTextures;
#endif
#if TEXTURE
  precision highp sampler2DArray;
  in vec3 vTexture;
  uniform sampler2DArray uTexture;
#endif
  uniform float uGrain;     // cells of the grain in a metre
  uniform vec4 uSection;    // what lies beyond this plane is left out
  uniform vec3 uLight;      // towards the lights, unit
  uniform vec3 uFill;
  uniform float uAmbient;
  out vec4 colour;

  float hash(vec3 p) {
    p = fract(p * vec3(0.1031, 0.1030, 0.0973));
    p += dot(p, p.yxz + 33.33);
    return fract((p.x + p.y) * p.z);
  }
  float noise(vec3 p) {
    vec3 i = floor(p), f = fract(p);
    f = f * f * (3.0 - 2.0 * f);
    return mix(mix(mix(hash(i), hash(i + vec3(1, 0, 0)), f.x), mix(hash(i + vec3(0, 1, 0)), hash(i + vec3(1, 1, 0)), f.x), f.y),
               mix(mix(hash(i + vec3(0, 0, 1)), hash(i + vec3(1, 0, 1)), f.x), mix(hash(i + vec3(0, 1, 1)), hash(i + vec3(1, 1, 1)), f.x), f.y), f.z);
  }
  // A wave of period 1 and height 1, without a sine, which costs several times as much on a processor.
  vec2 wave(vec2 x) {
    x = abs(2.0 * fract(x) - 1.0);
    return x * x * (6.0 - 4.0 * x) - 1.0;
  }
  // How far from the middle of a vessel, in its radii. Vessels run along x in wavy lines, one at most in each square cell across it.
  float vessel(vec3 q, float cells, float seed) {
    vec2 p = cells * (q.yz + wave(vec2(0.065 * q.x + 0.048 * q.z, 0.059 * q.x - 0.048 * q.y) + vec2(0.16, 0.32) * seed));
    vec2 cell = floor(p);
    vec2 r = vec2(hash(vec3(cell, seed)), hash(vec3(cell.yx, seed + 5.0)));
    float radius = 0.24 * (r.x + r.y - 0.9);  // fewer than half of the cells have one
    return radius > 0.0 ? length(fract(p) - 0.5 - 0.4 * (r.yx - 0.5)) / radius : 9.0;
  }
  float fourth(float x) { x *= x; return x * x; }
  // sRGB's curve by roots: several times quicker than pow() on a processor, and within half a step of 255 (Chilliant
  // 2012).
  vec3 srgb(vec3 c) {
    vec3 a = sqrt(clamp(c, 0.0, 1.0)), b = sqrt(a), d = sqrt(b);
    return 0.662002687 * a + 0.684122060 * b - 0.323583601 * d - 0.0225411470 * c;
  }
  vec3 pieceColour(float row) {
    if (row < 0.5) return vec3(0.30, 0.075, 0.060);
    float h = fract(0.08 + row * 0.61803399);
    vec3 rgb = clamp(abs(mod(h * 6.0 + vec3(0.0, 4.0, 2.0), 6.0) - 3.0) - 1.0, 0.0, 1.0);
    return mix(vec3(0.28), rgb, 0.55) * vec3(0.46, 0.44, 0.50);
  }
  // Viridis' ends and middle: dark is poor, bright is good.
  vec3 qualityColour(float q) {
    vec3 low = vec3(0.27, 0.0, 0.33), mid = vec3(0.13, 0.57, 0.55), high = vec3(0.99, 0.91, 0.14);
    return pow(q < 0.5 ? mix(low, mid, 2.0 * q) : mix(mid, high, 2.0 * q - 1.0), vec3(2.2)) * 0.9;
  }

  void main() {
    vec3 toEye = normalize(cameraPosition - vWorld);
    vec3 place = vRest;
#if INSIDE
    if (dot(vWorld, uSection.xyz) > uSection.w) discard;
    bool inside = !gl_FrontFacing;
    if (inside) {
      // What is behind the surface can only be seen through the section: the plane is filled there.
      float along = dot(toEye, uSection.xyz);
      if (abs(along) > 1e-4) place = vWorld + toEye * (uSection.w - dot(vWorld, uSection.xyz)) / along + vShift;
    }
#else
    const bool inside = false;
#endif
    float coarse = vCoarse;
#if DETAIL
    float fine = noise(place * uGrain * 4.3 + 7.0);
#else
    float fine = 0.5;
#endif
    bool cut = vFacts.x > 0.5 || inside;
    float rough = 0.33;

#if COLOURING == 2
    vec3 base = inside ? vec3(0.12) : 0.42 * qualityColour(vFacts.y);
#elif COLOURING == 1
    vec3 base = pieceColour(vFacts.z) * (0.8 + 0.2 * coarse) * (cut ? 1.5 : 1.0);
#else
    // Of a liver, where nothing else is said.
    vec3 inner = vec3(0.155, 0.0210, 0.0144), outer = vec3(0.138, 0.0243, 0.0175);
    float vessels = 1.0, rim = 0.5, pattern = 1.0;
#if REGIONS
    int region = int(vRegion + 0.5);
#if REGION_IMAGE
    if (inside) {
      vec3 t = (uRegionsFromRest * vec4(place, 1.0)).xyz;
      int there = int(texture(uRegions, t).r * 255.0 + 0.5);
      if (there < 255 && all(greaterThanEqual(t, vec3(0.0))) && all(lessThanEqual(t, vec3(1.0)))) region = there;
    }
#endif
    vec4 innerLook = texelFetch(uLooks, ivec2(0, region), 0), more = texelFetch(uLooks, ivec2(1, region), 0),
         outerLook = texelFetch(uLooks, ivec2(2, region), 0);
    inner = innerLook.rgb;
    outer = outerLook.rgb;
    pattern = more.x;
    vessels = more.y;
    rim = more.z;
    rough = cut ? innerLook.a : outerLook.a;
#endif
    vec3 skin = outer * mix(vec3(0.71, 0.64, 0.69), vec3(1.29, 1.36, 1.31), 0.6 * coarse + 0.4 * fine);
    // The inside, by where it is in the body at rest.
    float depth = inside ? 1.0 : vDepth;
    vec3 q = place * uGrain;
#if DETAIL
    float small = noise(q * 9.0 + 3.0 * coarse);
#else
    const float small = 0.2;
#endif
    float net = 1.0 - smoothstep(0.02, 0.13, abs(small - 0.5));
    vec3 flesh = inner * mix(vec3(0.74, 0.66, 0.68), vec3(1.26, 1.34, 1.32), 0.35 * fine + 0.65 * coarse);
#if REGIONS
    if (pattern > 3.5) {  // pores: marrow in a lattice
      flesh = mix(1.5 * inner, 0.5 * inner * vec3(1.0, 0.55, 0.5), smoothstep(0.42, 0.58, fine));
    } else if (pattern > 2.5) {  // globules between pale walls
      flesh *= 0.86 + 0.22 * small;
      flesh = mix(flesh, 1.25 * inner + 0.05, 0.5 * net);
    } else if (pattern > 1.5) {  // fibres in bundles
      float fibres = noise(vec3(q.x * 1.1, q.y * 13.0, q.z * 13.0) + 2.0 * coarse);
      flesh *= 0.78 + 0.44 * fibres;
      flesh = mix(flesh, inner + vec3(0.22, 0.13, 0.10), 0.55 * (1.0 - smoothstep(0.0, 0.035, abs(noise(vec3(q.x * 0.5, q.y * 3.2, q.z * 3.2)) - 0.5))));
    } else if (pattern > 0.5)
#endif
    // Lobules: darker middles, paler walls.
    flesh = mix(flesh * (0.93 + 0.10 * small), 1.25 * inner + vec3(0.035, 0.012, 0.008), 0.22 * net);
    // Vessels with pale walls and blood in them, large ones and across them small ones.
    float off = vessel(q, 0.21, 1.0);
#if DETAIL
    off = min(off, vessel(q.yzx, 0.62, 2.0));
#endif
    off /= 0.001 + sqrt(vessels);
    flesh = mix(flesh, 0.55 * inner + vec3(0.215, 0.100, 0.080), 0.8 - 0.8 * smoothstep(1.0, 1.22, off));
    float blood = 1.0 - smoothstep(0.74, 0.9, off);
    flesh = mix(flesh, vec3(0.030, 0.0020, 0.0030) * (0.6 + 0.8 * off), blood);
    if (cut) rough = mix(rough, 0.12, blood);
    float fatDepth = rim * (0.07 + 0.26 * coarse * (0.5 + fine));
    float fat = rim > 0.0 ? 1.0 - smoothstep(0.7 * fatDepth, fatDepth, depth) : 0.0;
    flesh = mix(flesh, mix(vec3(0.40, 0.215, 0.095), vec3(0.52, 0.325, 0.165), 0.35 * fine + 0.65 * (1.0 - net)), fat);
    // The capsule.
    flesh = mix(flesh, vec3(0.50, 0.340, 0.290), step(0.001, rim) * (1.0 - smoothstep(0.03, 0.06, depth)));
#if REGION_TEXTURES
    float layer = cut ? more.w : texelFetch(uLooks, ivec2(3, region), 0).x;
    if (layer > -0.5) {
      // From three sides, a square of 5 cm: solid coordinates have no seams.
      vec3 a = abs(normalize(vNormal));
      if (inside) a = abs(uSection.xyz);
      a = a * a * a * a;
      a /= a.x + a.y + a.z;
      vec3 t = place / 0.05;
      vec3 seen = a.x * texture(uRegionTextures, vec3(t.yz, layer)).rgb + a.y * texture(uRegionTextures, vec3(t.xz, layer)).rgb + a.z * texture(uRegionTextures, vec3(t.xy, layer)).rgb;
      if (cut) flesh = mix(0.45 * seen, flesh, max(fat, blood));
      else skin = 0.45 * seen;
    }
#endif
#if TEXTURE
    // Images are painted as they are to look in even light; the lights here are brighter.
    vec3 painted = 0.40 * texture(uTexture, vTexture).rgb;
    if (vTexture.z > -0.5) skin = painted;
#endif
    vec3 base = cut ? flesh : skin;
#endif

#if INSIDE
    vec3 n = normalize(!inside ? vNormal : dot(uSection.xyz, uSection.xyz) > 0.5 ? uSection.xyz : -vNormal);
#else
    vec3 n = normalize(vNormal);
#endif
#if COLOURING != 2
    n = normalize(n + (cut && !inside ? 0.13 : 0.075) * (vec3(fine, coarse, fract(3.0 * fine + 2.0 * coarse)) - 0.5));
#endif
    float wrap = clamp((dot(n, uLight) + 0.35) / 1.35, 0.0, 1.0);
    float fill = clamp(dot(n, uFill) * 0.5 + 0.5, 0.0, 1.0);
    float sky = 0.5 + 0.5 * n.z;
    vec3 light = wrap * wrap * vec3(2.15, 2.05, 1.95) + fill * vec3(0.34, 0.40, 0.50) + uAmbient * mix(vec3(0.20, 0.15, 0.14), vec3(0.46, 0.48, 0.52), sky);
    vec3 lit = base * light;
    // A little of the light that entered comes out red beyond the terminator.
    lit += base * vec3(0.55, 0.10, 0.06) * smoothstep(0.0, 0.5, wrap) * (1.0 - smoothstep(0.3, 0.8, wrap));

#if COLOURING != 2
    {
      vec3 h = normalize(uLight + toEye);
      float nh = max(dot(n, h), 0.0);
      float rim = fourth(1.0 - max(dot(n, toEye), 0.0));
      float broad = fourth(fourth(nh));
      float wet = (inside ? 0.12 : 1.0) * 1.5 * (1.0 - rough);  // a plane shines all over
      lit += wet * ((0.08 + 0.06 * fine) * broad + mix(0.7, 0.0, min(1.0, 1.25 * rough)) * fourth(broad) * fourth(broad)) * vec3(1.0, 0.97, 0.94) * step(0.0, dot(n, uLight));
      // A film of fluid mirrors a broad lamp, in patches: where tissue is even it is smooth.
      if (cut && !inside) {
        vec3 mirrored = reflect(-toEye, normalize(n + 0.22 * (vec3(coarse, fine, 1.0 - coarse) - 0.5)));
        lit += wet * (0.05 + 0.16 * fine * fine) * smoothstep(0.30, 0.95, dot(mirrored, uLight));
      }
      // Cut faces see other tissue beside them, not the sky.
      lit += wet * rim * (cut ? vec3(0.035, 0.022, 0.022) : vec3(0.10, 0.11, 0.13));
      vec3 h2 = normalize(uFill + toEye);
      float second = fourth(max(dot(n, h2), 0.0));
      lit += wet * 0.06 * fourth(second) * fourth(second);
    }
#endif
#if WIRE
    if (!inside) {
      vec3 d = vEdge / fwidth(vEdge);
      float line = 1.0 - smoothstep(0.4, 1.3, min(min(d.x, d.y), d.z));
      vec3 ink = COLOURING == 0 ? (cut ? vec3(0.35, 0.05, 0.05) : vec3(0.95, 0.62, 0.55)) : vec3(0.02);
      lit = mix(lit, ink, 0.55 * line);
    }
#endif
    // A shoulder for the highlights, then sRGB.
    lit = lit / (1.0 + 0.22 * lit);
    colour = vec4(srgb(lit), 1.0);
#if IMAGE
    vec3 t = (uImageFromRest * vec4(place, 1.0)).xyz;
    if (cut && all(greaterThanEqual(t, vec3(0.0))) && all(lessThanEqual(t, vec3(1.0)))) {
      // As it is on a plane, where it is read; a little light on cut faces, to see their shape.
      colour.rgb = vec3(texture(uImage, t).r) * (inside ? 1.0 : 0.7 + 0.3 * wrap);
    }
#endif
#if SECTION
    // The two sides of a closed cut lie at the same depth: the one that is seen from inside fills the section.
    gl_FragDepth = gl_FragCoord.z - (inside ? 2e-6 : 0.0);
#endif
  }
`;
