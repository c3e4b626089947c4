#pragma once

#include <cstdint>
#include <utility>
#include <vector>

namespace incise::haptics {

// What a tissue feels like under an edge. Defaults: liver.
struct Material {
  // Work for each area of new cut surface, J/m^2 (the same as N for each metre of edge). Bovine liver, needles:
  // 164 +- 6 (Gokgol, Basdogan and Canadinc 2012, "Estimation of fracture toughness of liver tissue: experiments
  // and validation"); porcine liver, in vivo: 76 to 185 (Azar and Hayward 2008, "Estimation of the fracture
  // toughness of soft tissue from needle insertion").
  double toughness_j_m2 = 164;
  // Force at which a point punctures the surface, N. For an organ's capsule; some tenths of a newton to 2 N for needles in
  // bovine liver (Okamura, Simone and O'Leary 2004, "Force modeling for needle insertion into soft tissue").
  double puncture_n = 0.8;
  // How fast the force grows as the tissue gives before it tears: under a point, N/m, and more for each metre of edge,
  // N/m^2. The order of what those insertions show before the puncture (1 N within a few millimetres), and of a liver's
  // modulus (some 10 kPa); chosen, not measured. An edge tears after toughness / modulus: 4 mm.
  double stiffness_n_m = 300;
  double stiffness_pa = 40e3;
  // Viscous friction along the faces of the blade, N s/m for each metre of edge inside. Chosen for feel: 0.1 N at
  // 0.1 m/s with 5 cm of edge.
  double friction_n_s_m2 = 20;

  friend bool operator==(const Material&, const Material&) = default;
};

// The material of each region of a mesh.
struct Materials {
  Material tissue;                                           // of all regions that are not listed
  std::vector<std::pair<std::int32_t, Material>> by_region;  // a handful: searched from the front

  const Material& of(std::int32_t region) const noexcept {
    for (const auto& [number, material] : by_region) {
      if (number == region) return material;
    }
    return tissue;
  }
};

}  // namespace incise::haptics
