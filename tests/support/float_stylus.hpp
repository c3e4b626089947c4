#pragma once

#include <string>

namespace incise::tests {

// The profile of a stylus whose numbers are floating point ones: they can be none. `match`: the members that say which
// device it is for.
inline std::string float_stylus_profile(const std::string& match) {
  return R"({"name": "Float", )" + match + R"(, "report": 1, "rate_hz": 1000,
  "counter": {"at": 1, "type": "u16"},
  "tools": [{"position": {"x": {"at": 4, "type": "f32"}, "y": {"at": 8, "type": "f32"}, "z": {"at": 12, "type": "f32"}},
             "buttons": [{"at": 3, "bit": 0, "type": "u1"}], "valid": {"at": 3, "bit": 1, "type": "u1"}}],
  "force": {"max_newtons": 3.3, "bytes": "02 00*12", "x": {"at": 1, "type": "i32", "scale": 1e-6},
            "y": {"at": 5, "type": "i32", "scale": 1e-6}, "z": {"at": 9, "type": "i32", "scale": 1e-6}}})";
}

}  // namespace incise::tests
