// Keys of the body, the blade, the cut and the loop.
#include <cmath>

#include "server/app/config/config_key.hpp"

namespace incise::app {

namespace {

ConfigKey image_window() {
  return {
      "mesh.image_window", "[black, white], two numbers, the first the smaller; or []",
      "Which of the image's numbers are shown as black and as white; []: those that all but one in a hundred "
      "samples around the body are above and below.",
      [](const Config& c) { return Json(c.mesh.image_window); },
      [](Config& c, const Json& value) {
        if (!value.is_array() || (!value.empty() && value.size() != 2)) return false;
        for (const Json& number : value)
          if (!number.is_number() || !(std::abs(number.get<double>()) <= 1e30)) return false;
        if (value.size() == 2 && !(value[0].get<double>() < value[1].get<double>())) return false;
        c.mesh.image_window = value.get<std::vector<double>>();
        return true;
      }};
}

}  // namespace

ConfigKeys mesh_keys() {
  return {
      text("mesh.path", INCISE_FIELD(mesh.path), "a path, relative to this file",
           "The body: a tetrahedral mesh (TetGen .node/.ele, or their common name; .msh, .vtk, .vtu, .mesh, "
           ".veg) or a closed surface (.stl .ply .off .obj .glb), which is filled with tetrahedra."),
      word("mesh.phantom", {"", "liver", "cylinder", "slab"}, INCISE_FIELD(mesh.phantom),
           "Instead of a file: a body that is generated at the start, with mesh.target_tets tetrahedra."),
      number("mesh.scale_to_metres", INCISE_FIELD(mesh.scale_to_metres), 1e-9, 1e9,
             "The file's coordinates times this are metres: 0.001 for a file in millimetres."),
      integer("mesh.target_tets", INCISE_FIELD(mesh.target_tets), 0, 20'000'000,
              "How many tetrahedra to fill a surface with (0: as few as the surface allows), or to generate "
              "a phantom with."),
      text("mesh.tetgen_switches", INCISE_FIELD(mesh.tetgen_switches), "TetGen's switches, a text",
           "How to fill a surface; see TetGen's manual, section 4.2. The volume bound comes from "
           "mesh.target_tets."),
      number("mesh.fill_time_limit_s", INCISE_FIELD(mesh.fill_time_limit_s), 1, 86'400,
             "Stop filling a surface after this time."),
      integer("mesh.fill_memory_limit_mb", INCISE_FIELD(mesh.fill_memory_limit_mb), 64, 1 << 24,
              "The most memory that filling may use."),
      text("mesh.cache_directory", INCISE_FIELD(mesh.cache_directory),
           "a path, relative to this file; or \"\"",
           "Where filled surfaces are kept for the next start; \"\": ~/.cache/incise."),
      texts("mesh.fields", INCISE_FIELD(mesh.fields),
            "a list of texts \"NAME\", with \":N\" (2 to 9 numbers each), \":tets\" and \":int\" behind it",
            "Fields for clients to set, beside those of the file, which they may set, too: floats on the "
            "vertices, "
            "0 at first, or as \"strain:6:tets\" says."),
      text("mesh.image", INCISE_FIELD(mesh.image), "a path, relative to this file; or \"\"",
           "A volume image of the body (CT, MR): NRRD (.nrrd, .nhdr) or NIfTI-1 (.nii, .nii.gz). Viewers can "
           "show it on cut faces "
           "and on the section plane."),
      image_window(),
      word("mesh.image_space", {"LPS", "RAS"}, INCISE_FIELD(mesh.image_space),
           "How the body's axes lie in the patient, so that the image, which says how its own do, is put "
           "into it: x to the left and y to the back "
           "(DICOM, ITK; what 3D Slicer writes), or x to the right and y to the front."),
      number("mesh.image_scale_to_metres", INCISE_FIELD(mesh.image_scale_to_metres), 1e-9, 1e9,
             "The image's millimetres times this are metres of the body; a unit that the image names is made "
             "millimetres first."),
      point("mesh.image_origin", INCISE_FIELD(mesh.image_origin),
            "Where the origin of the image's coordinates lies in the body, metres."),
  };
}

ConfigKeys blade_keys() {
  return {
      point("blade.heel", INCISE_FIELD(cut.blade.heel),
            "One end of the cutting edge in the tool's frame, metres."),
      point("blade.tip", INCISE_FIELD(cut.blade.tip), "Its other end."),
  };
}

ConfigKeys cut_keys() {
  return {
      choice("cut.policy", {"conforming", "croll"}, INCISE_FIELD(cut.policy),
             "How a swept surface becomes a cut: \"conforming\" follows it exactly; \"croll\" is the "
             "baseline of 2007."),
      choice("cut.prefer", {"no-growth", "balanced", "exact"}, INCISE_FIELD(cut.prefer),
             "What to prefer where accuracy and few new tetrahedra conflict (policy conforming): "
             "\"no-growth\" never adds one, and leaves the cut ragged where no vertex can be moved; "
             "\"balanced\" splits an edge where it must; \"exact\" splits nearly all, so that parts thinner "
             "than an element stay as they are."),
      choice_key(
          "cut.engage", {"buttons", "always", "resistance"},
          "When the blade cuts: while one of cut.engage_buttons is held, or always. With \"resistance\" a "
          "blade whose "
          "button is held presses until the force model says that the tissue yields, and cuts from there on "
          "(incise feel does so, too; incise cut has no forces, so its blade always cuts).",
          [](const Config& c) -> std::size_t {
            return c.haptics.force.resists ? 2 : c.cut.always_engaged ? 1 : 0;
          },
          [](Config& c, std::size_t i) {
            c.cut.always_engaged = i == 1;
            c.haptics.force.resists = i == 2;
          }),
      integer(
          "cut.engage_buttons", INCISE_FIELD(cut.engage_buttons), 1, 0xffffffff,
          "The buttons that engage the blade, as a sum: 1 for button 0, 2 for button 1, 4 for button 2, ..."),
      number("cut.batch_h", INCISE_FIELD(cut.batch_h), 0.05, 100,
             "How far the blade travels before its cut is committed as one batch, in mean edge lengths. "
             "With the policy croll less than 1 counts as 1."),
      number("cut.chord_tolerance_h", INCISE_FIELD(cut.chord_tolerance_h), 1e-4, 1,
             "How far the cut surface may deviate from the poses, in mean edge lengths. Where the blade "
             "moves less than a third of one, up to 0.08 counts as the device's noise."),
      number("cut.speed_limit_m_s", INCISE_FIELD(cut.speed_limit_m_s), 1e-3, 1e6,
             "A faster motion is a jump: it ends the stroke and begins another, and does not cut. Poses less "
             "than 1 ms apart may be as far from each other as in 1 ms."),
      number("cut.gap_limit_s", INCISE_FIELD(cut.gap_limit_s), 1e-3, 3600,
             "A longer gap between two poses also ends the stroke and begins another."),
  };
}

ConfigKeys loop_keys() {
  return {
      number("loop.rate_hz", INCISE_FIELD(loop.rate_hz), 250, 4000,
             "Frames a second without poses. With poses a frame begins when they arrive."),
      number(
          "loop.budget_fraction", INCISE_FIELD(loop.budget_fraction), 0.01, 0.95,
          "The part of a frame that input and cutting may use; what does not fit waits for the next frame."),
      integer("loop.realtime_priority", INCISE_FIELD(loop.realtime_priority), 0, 99,
              "Priority of the loop's thread under SCHED_FIFO, if the system grants it; 0: do not ask."),
      integer("loop.cpu", INCISE_FIELD(loop.cpu), -1, 1023,
              "The processor that the loop's thread is bound to; -1: any."),
      boolean("loop.lock_memory", INCISE_FIELD(loop.lock_memory),
              "Keep all memory from being swapped out, if the system grants it."),
  };
}

ConfigKeys haptics_keys() {
  return {
      boolean("haptics.forces", INCISE_FIELD(haptics.forces),
              "Compute the force on each blade, in each frame, for devices and operators."),
      number("haptics.max_force_n", INCISE_FIELD(haptics.force.limits.most_n), 0.01, 100,
             "The largest force; a device's own limit may be smaller."),
      number("haptics.max_torque_n_m", INCISE_FIELD(haptics.force.most_torque_n_m), 0, 10,
             "The largest torque about the tool's origin, for devices that make one; a device's own limit "
             "may be smaller. "
             "It changes as fast as the force, in proportion to the two limits. 0: none is made."),
      number("haptics.slew_n_s", INCISE_FIELD(haptics.force.limits.slew_n_s), 1, 1e5,
             "The fastest change of a force; at least a hundred times haptics.max_force_n, so that a fault "
             "ends it in 10 ms."),
      number(
          "haptics.silence_s", INCISE_FIELD(haptics.force.limits.silence_s), 0.02, 1,
          "If no pose comes for so long while a force acts, or a frame is late by a quarter of it, the force "
          "ends. More than 0.02 only where no motor makes the force: for recorded motions."),
      number("haptics.frozen_s", INCISE_FIELD(haptics.force.limits.frozen_s), 0.02, 1e6,
             "If poses stay identical to the bit for so long while a force acts, the device is stuck and the "
             "force ends."),
      number("haptics.stiffest_n_m", INCISE_FIELD(haptics.force.stiffest_n_m), 10, 20'000,
             "The stiffest that tissue may feel: more makes a device tremble."),
      number("haptics.damping_n_s_m", INCISE_FIELD(haptics.force.damping_n_s_m), 0, 50,
             "Damping of the contact with a surface, along its normal."),
      number("haptics.contact_valid_ms", INCISE_FIELD(haptics.contact_valid_ms), 1, 1000,
             "How long an operator on the network may render the last contact that it received."),
      number("haptics.toughness_j_m2", INCISE_FIELD(haptics.force.materials.tissue.toughness_j_m2), 0, 1e5,
             "Of the tissue: work for each area of cut. Liver: 76 to 185, 164 in bovine."),
      number("haptics.puncture_n", INCISE_FIELD(haptics.force.materials.tissue.puncture_n), 0, 100,
             "The force with which a point must press before it enters."),
      number("haptics.stiffness_n_m", INCISE_FIELD(haptics.force.materials.tissue.stiffness_n_m), 1, 1e5,
             "How fast the force grows under a point before the tissue tears."),
      number("haptics.stiffness_pa", INCISE_FIELD(haptics.force.materials.tissue.stiffness_pa), 0, 1e7,
             "How much faster it grows for each metre of edge that presses."),
      number("haptics.friction_n_s_m2", INCISE_FIELD(haptics.force.materials.tissue.friction_n_s_m2), 0, 1e4,
             "Viscous friction on the blade's faces, for each metre of edge inside."),
  };
}

}  // namespace incise::app
