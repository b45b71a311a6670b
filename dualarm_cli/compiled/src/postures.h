/* Postures over a cell of platform angle and arm angle: shared by the files that enclose them and their lines.

   Over an interval of the platform angle the arm plane is carried along from the interval's middle by the smallest
   rotation, in the world, of the line from shoulder to wrist. */

#ifndef POSTURES_H
#define POSTURES_H

#include <stdint.h>

#include "srs.h"

enum { CORNERS = 4, WAVES = 10, DIRECTIONS = 2 };

/* Joints of shoulder and wrist: outer, middle and along the link. */
static const int JOINT[2][3] = {{0, 1, 2}, {6, 5, 4}};

/* What enclosures are widened by, since they are computed in floating point. */
static const double ROUNDING = 1e-6;

/* All numbers within `radius` of `middle`; a radius that is not finite tells nothing. */
typedef struct {
    double middle, radius;
} Range;

/* A function of the platform angle over an interval: its value, first and second derivative. */
typedef struct {
    Range of[3];
} Jet;

/* sine * sin(psi) + cosine * cos(psi) + constant. */
typedef struct {
    Jet sine, cosine, constant;
    double size[3]; /* of the middles of sine and cosine together */
} Wave;

/* A flange pose that stands in the world, over an interval of the platform angle. */
typedef struct {
    double low, high;
    double frame[3][3]; /* shoulder-wrist line and both directions of the arm plane at the middle, carried frame */
    Wave wave[WAVES];   /* cosines of the middle joints (0, 5), numerators and denominators of the tangents of others */
    Jet bend;           /* cosine of joint 4 */
    Range link[2][2];   /* cosine and sine of the angles of upper arm and forearm to the line */
} Shape;

/* What a joint does over a cell, but for its values at the corners. */
typedef struct {
    Range second[DIRECTIONS][JOINTS]; /* second derivatives: by platform angle, by arm angle */
    uint8_t smooth[JOINTS];           /* whether neighbouring corners are less than half a turn apart */
    Range value[JOINTS];              /* all of its values at once; of joints 2, 4 and 6 the positive angle */
} Bends;

/* Positions of a joint from `low` to `high`, of any turn. */
typedef struct {
    double low, high;
} Span;

/* Fills the shape of a flange pose, R (9) and p (3) in the carried frame at platform angle zero. */
void shape_of(const Arm *arm, const double *R, const double *p, double low, double high, Shape *shape);

/* Joints at the corners of an interval's cells, (2, parts, 7): at its low and high end, the circle in equal parts from
   -pi on; of joints 2, 4 and 6 the positive angle, offsets apart. */
void corners_of(const Arm *arm, const double *R, const double *p, const Shape *shape, int64_t parts, double *corner);

/* Fills what the joints do over the parts of the circle, (parts,). */
void bends_of(const Arm *arm, const Shape *shape, int64_t parts, Bends *bends);

/* Fills the positions of all joints over the parts of the circle, (parts, 7), of joints 2, 4 and 6 the positive angles:
   around their corners, or all values at once, whichever is narrower; half-widths h. */
void spans_of(int64_t parts, const double h[DIRECTIONS], const double *corner, const Bends *bends, Span *span);

/* Adds how far a function is below and above its chords over a half-width h, given its second derivative. */
static inline void add_slack(Range second, double h, double *below, double *above)
{
    const double most = second.middle + second.radius, least = second.middle - second.radius;
    *below += most > 0.0 ? 0.5 * most * h * h : 0.0;
    *above += least < 0.0 ? -0.5 * least * h * h : 0.0;
}

#endif
