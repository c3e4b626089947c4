// That the header is C, and that a compiler lays its structures out as it says.

#include <assert.h>
#include <stddef.h>

#include "protocol/hid/incise_stylus.h"

static_assert(sizeof(incise_stylus_input) == 40, "input");
static_assert(sizeof(incise_stylus_output) == 16, "output");
static_assert(sizeof(incise_stylus_settings) == 4, "settings");
static_assert(offsetof(incise_stylus_input, time_us) == 4, "time_us");
static_assert(offsetof(incise_stylus_input, rotation) == 20, "rotation");
static_assert(offsetof(incise_stylus_output, force) == 4, "force");
static_assert(sizeof(incise_stylus_6_output) == 28, "output with torque");
static_assert(offsetof(incise_stylus_6_output, torque) == 16, "torque");

const unsigned char kStylusDescriptor[] = {INCISE_STYLUS_REPORT_DESCRIPTOR};
const unsigned kStylusDescriptorSize = sizeof kStylusDescriptor;
const unsigned char kStylus6Descriptor[] = {INCISE_STYLUS_6_REPORT_DESCRIPTOR};
const unsigned kStylus6DescriptorSize = sizeof kStylus6Descriptor;
