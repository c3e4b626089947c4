/* The Incise Reference Stylus: a HID layout for haptic devices, version 1. C99 and C++.
 *
 * A device that sends and takes these reports works with Incise as it is, whatever its vendor and product numbers: it is
 * known by the usage of its top-level collection, INCISE_STYLUS_USAGE_PAGE and INCISE_STYLUS_USAGE, which stands for
 * version 1. One that also makes torques has INCISE_STYLUS_6_USAGE and INCISE_STYLUS_6_REPORT_DESCRIPTOR: the same reports, and
 * one more. Numbers are little-endian and not padded; byte 0 of a report is its number, and numbers of 32 bits lie at
 * multiples of 4. Full-speed USB (1 kHz) and high-speed USB (up to 8 kHz) carry each report in one transaction.
 *
 * Frame: right-handed, seen from the user: x to the right, y away, z up; the origin is the middle of the workspace. A
 * point p of the stylus is at position + q p q* (Hamilton's convention). Units: nanometres, microseconds, micronewtons,
 * micronewton metres.
 *
 * What the firmware does:
 *  - sends an input report every 1 / rate_hz, whether anything moved or not, and samples position, rotation, time and
 *    counter together; the counter rises by one from report to report sent, so that a host sees what got lost;
 *  - clears INCISE_STYLUS_VALID while it does not know the pose: a host then ends the cut;
 *  - makes the force of the newest output report, on the hand, at the stylus's origin, within its own limits;
 *  - makes no force once INCISE_STYLUS_FORCE_ON is clear, once no output report has come for 20 ms, after a reset, and
 *    when the host suspends or leaves the bus; it releases within 10 ms, and does not wait for the host to ask.
 */
#ifndef INCISE_STYLUS_H
#define INCISE_STYLUS_H

#include <stdint.h>

#define INCISE_STYLUS_USAGE_PAGE 0xff1cu
#define INCISE_STYLUS_USAGE 0x0001u
#define INCISE_STYLUS_6_USAGE 0x0002u

enum { INCISE_STYLUS_INPUT = 1, INCISE_STYLUS_OUTPUT = 2, INCISE_STYLUS_SETTINGS = 3, INCISE_STYLUS_6_OUTPUT = 4 };

#pragma pack(push, 1)

enum { INCISE_STYLUS_VALID = 1, INCISE_STYLUS_MOTORS_ON = 2, INCISE_STYLUS_FAULT = 4 };

typedef struct {
  uint8_t report;       /* INCISE_STYLUS_INPUT */
  uint8_t flags;        /* INCISE_STYLUS_VALID, ... */
  uint16_t counter;     /* of the reports sent, wraps */
  uint32_t time_us;     /* when it was measured, by the device's clock, wraps */
  int32_t position[3];  /* x y z, nm */
  int32_t rotation[4];  /* w x y z, times 2^30; of unit length */
  uint16_t buttons;     /* bit i: button i is held; button 0 engages the blade */
  uint16_t grip;        /* 0 open ... 65535 closed; 0 if the device has no grip */
} incise_stylus_input;  /* 40 bytes */

enum { INCISE_STYLUS_FORCE_ON = 1 };

typedef struct {
  uint8_t report;       /* INCISE_STYLUS_OUTPUT */
  uint8_t flags;        /* INCISE_STYLUS_FORCE_ON */
  uint16_t reserved;    /* 0 */
  int32_t force[3];     /* x y z, uN */
} incise_stylus_output; /* 16 bytes */

/* Instead of incise_stylus_output, from a host that makes torques; the same rules hold for it. */
typedef struct {
  uint8_t report;       /* INCISE_STYLUS_6_OUTPUT */
  uint8_t flags;        /* INCISE_STYLUS_FORCE_ON */
  uint16_t reserved;    /* 0 */
  int32_t force[3];     /* x y z, uN */
  int32_t torque[3];    /* x y z, uN m, on the hand, about the stylus's origin, along the frame's axes */
} incise_stylus_6_output; /* 28 bytes */

typedef struct {
  uint8_t report;         /* INCISE_STYLUS_SETTINGS, a feature report, set by the host before it reads */
  uint8_t version;        /* 1 */
  uint16_t rate_hz;       /* input reports a second that the host wants: 1000 to 8000; the device takes the nearest it has */
} incise_stylus_settings; /* 4 bytes */

#pragma pack(pop)

/* The report descriptors, byte for byte. INCISE_STYLUS_ITEMS_ is what both have. */
#define INCISE_STYLUS_ITEMS_                                                                                         \
  0xa1, 0x01,                         /* Collection (Application) */                                                 \
  0x85, 0x01,                         /*   Report ID (1): input */                                                   \
  0x15, 0x00, 0x25, 0x01,             /*   Logical 0 ... 1 */                                                        \
  0x75, 0x01, 0x95, 0x08,             /*   8 fields of 1 bit */                                                      \
  0x09, 0x10, 0x81, 0x02,             /*   Usage (flags), Input (Variable) */                                        \
  0x27, 0xff, 0xff, 0x00, 0x00,       /*   Logical 0 ... 65535 */                                                    \
  0x75, 0x10, 0x95, 0x01,             /*   1 field of 16 bits */                                                     \
  0x09, 0x11, 0x81, 0x02,             /*   Usage (counter), Input (Variable) */                                      \
  0x27, 0xff, 0xff, 0xff, 0x7f,       /*   Logical 0 ... 2^31 - 1 */                                                 \
  0x75, 0x20,                         /*   32 bits */                                                                \
  0x09, 0x12, 0x81, 0x02,             /*   Usage (time), Input (Variable) */                                         \
  0x17, 0x01, 0x00, 0x00, 0x80,       /*   Logical -(2^31 - 1) ... 2^31 - 1 */                                       \
  0x65, 0x11, 0x55, 0x09,             /*   Unit (centimetre), Unit Exponent (-7): nm */                              \
  0x95, 0x03,                         /*   3 fields */                                                               \
  0x09, 0x20, 0x09, 0x21, 0x09, 0x22, /*   Usages (position x, y, z) */                                              \
  0x81, 0x02,                         /*   Input (Variable) */                                                       \
  0x17, 0x00, 0x00, 0x00, 0xc0,       /*   Logical -2^30 ... 2^30 */                                                 \
  0x27, 0x00, 0x00, 0x00, 0x40,                                                                                      \
  0x65, 0x00, 0x55, 0x00,             /*   no unit */                                                                \
  0x95, 0x04,                         /*   4 fields */                                                               \
  0x09, 0x23, 0x09, 0x24, 0x09, 0x25, 0x09, 0x26, /* Usages (rotation w, x, y, z) */                                 \
  0x81, 0x02,                         /*   Input (Variable) */                                                       \
  0x15, 0x00, 0x25, 0x01,             /*   Logical 0 ... 1 */                                                        \
  0x75, 0x01, 0x95, 0x10,             /*   16 fields of 1 bit */                                                     \
  0x05, 0x09, 0x19, 0x01, 0x29, 0x10, /*   Usage Page (Button), Usages 1 ... 16 */                                   \
  0x81, 0x02,                         /*   Input (Variable) */                                                       \
  0x06, 0x1c, 0xff,                   /*   Usage Page (INCISE_STYLUS_USAGE_PAGE) */                                  \
  0x27, 0xff, 0xff, 0x00, 0x00,       /*   Logical 0 ... 65535 */                                                    \
  0x75, 0x10, 0x95, 0x01,             /*   1 field of 16 bits */                                                     \
  0x09, 0x28, 0x81, 0x02,             /*   Usage (grip), Input (Variable) */                                         \
  0x85, 0x02,                         /*   Report ID (2): output */                                                  \
  0x25, 0x01, 0x75, 0x01, 0x95, 0x08, /*   Logical 0 ... 1, 8 fields of 1 bit */                                     \
  0x09, 0x30, 0x91, 0x02,             /*   Usage (flags), Output (Variable) */                                       \
  0x27, 0xff, 0xff, 0x00, 0x00,       /*   Logical 0 ... 65535 */                                                    \
  0x75, 0x10, 0x95, 0x01,             /*   1 field of 16 bits */                                                     \
  0x09, 0x31, 0x91, 0x02,             /*   Usage (reserved), Output (Variable) */                                    \
  0x17, 0x01, 0x00, 0x00, 0x80,       /*   Logical -(2^31 - 1) ... 2^31 - 1 */                                       \
  0x27, 0xff, 0xff, 0xff, 0x7f,                                                                                      \
  0x67, 0x11, 0xe1, 0x00, 0x00,       /*   Unit (dyne = g cm / s^2) */                                               \
  0x55, 0x0f,                         /*   Unit Exponent (-1): uN */                                                 \
  0x75, 0x20, 0x95, 0x03,             /*   3 fields of 32 bits */                                                    \
  0x09, 0x32, 0x09, 0x33, 0x09, 0x34, /*   Usages (force x, y, z) */                                                 \
  0x91, 0x02,                         /*   Output (Variable) */                                                      \
  0x85, 0x03,                         /*   Report ID (3): feature */                                                 \
  0x65, 0x00, 0x55, 0x00,             /*   no unit */                                                                \
  0x15, 0x00, 0x26, 0xff, 0x00,       /*   Logical 0 ... 255 */                                                      \
  0x75, 0x08, 0x95, 0x01,             /*   1 field of 8 bits */                                                      \
  0x09, 0x40, 0xb1, 0x02,             /*   Usage (version), Feature (Variable) */                                    \
  0x27, 0xff, 0xff, 0x00, 0x00,       /*   Logical 0 ... 65535 */                                                    \
  0x75, 0x10,                         /*   16 bits */                                                                \
  0x09, 0x41, 0xb1, 0x02,             /*   Usage (rate), Feature (Variable) */

#define INCISE_STYLUS_REPORT_DESCRIPTOR                                                                              \
  0x06, 0x1c, 0xff,                   /* Usage Page (INCISE_STYLUS_USAGE_PAGE) */                                    \
  0x09, 0x01,                         /* Usage (INCISE_STYLUS_USAGE) */                                              \
  INCISE_STYLUS_ITEMS_                                                                                               \
  0xc0                                /* End Collection */

#define INCISE_STYLUS_6_REPORT_DESCRIPTOR                                                                            \
  0x06, 0x1c, 0xff,                   /* Usage Page (INCISE_STYLUS_USAGE_PAGE) */                                    \
  0x09, 0x02,                         /* Usage (INCISE_STYLUS_6_USAGE) */                                            \
  INCISE_STYLUS_ITEMS_                                                                                               \
  0x85, 0x04,                         /*   Report ID (4): output */                                                  \
  0x25, 0x01, 0x75, 0x01, 0x95, 0x08, /*   Logical 0 ... 1, 8 fields of 1 bit */                                     \
  0x09, 0x50, 0x91, 0x02,             /*   Usage (flags), Output (Variable) */                                       \
  0x27, 0xff, 0xff, 0x00, 0x00,       /*   Logical 0 ... 65535 */                                                    \
  0x75, 0x10, 0x95, 0x01,             /*   1 field of 16 bits */                                                     \
  0x09, 0x51, 0x91, 0x02,             /*   Usage (reserved), Output (Variable) */                                    \
  0x17, 0x01, 0x00, 0x00, 0x80,       /*   Logical -(2^31 - 1) ... 2^31 - 1 */                                       \
  0x27, 0xff, 0xff, 0xff, 0x7f,                                                                                      \
  0x67, 0x11, 0xe1, 0x00, 0x00,       /*   Unit (dyne = g cm / s^2) */                                               \
  0x55, 0x0f,                         /*   Unit Exponent (-1): uN */                                                 \
  0x75, 0x20, 0x95, 0x03,             /*   3 fields of 32 bits */                                                    \
  0x09, 0x52, 0x09, 0x53, 0x09, 0x54, /*   Usages (force x, y, z) */                                                 \
  0x91, 0x02,                         /*   Output (Variable) */                                                      \
  0x67, 0x21, 0xe1, 0x00, 0x00,       /*   Unit (dyne cm = g cm^2 / s^2) */                                          \
  0x55, 0x01,                         /*   Unit Exponent (1): uN m = 10 dyne cm */                                   \
  0x09, 0x55, 0x09, 0x56, 0x09, 0x57, /*   Usages (torque x, y, z) */                                                \
  0x91, 0x02,                         /*   Output (Variable) */                                                      \
  0xc0                                /* End Collection */

#endif
