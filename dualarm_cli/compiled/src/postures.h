/* Enclosures of the postures over a cell of platform angle and arm angle.

   Over an interval of the platform angle the arm plane is transported from the middle of the interval by the smallest
   rotation in the world of the line from shoulder to wrist. */

#ifndef POSTURES_H
#define POSTURES_H

#include <stdint.h>

#include "srs.h"

enum { CORNERS = 4, WAVES = 10, DIRECTIONS = 2 };

/* Joints of the shoulder and wrist triples: outer, middle, and along the link (inner). */
static const int JOINT[2][3] = {{0, 1, 2}, {6, 5, 4}};

/* Widening of the enclosures for rounding errors. */
static const double ROUNDING = 1e-6;

/* All numbers within `radius` of `middle`; unbounded if the radius is not finite. */
typedef struct {
    double middle, radius;
} Range;

/* Ranges of a function of the platform angle over an interval: value, first and second derivative. */
typedef struct {
    Range of[3];
} Jet;

/* Function sine * sin(psi) + cosine * cos(psi) + constant of the arm angle psi. */
typedef struct {
    Jet sine, cosine, constant;
    double size[3]; /* amplitudes, from the middles of sine and cosine */
} Wave;

/* Flange pose fixed in the world, over an interval of the platform angle. */
typedef struct {
    double low, high;
    double frame[3][3]; /* at the middle: shoulder-wrist line and both directions of the arm plane, carried frame */
    Wave wave[WAVES];   /* cosines of the middle joints (0, 5), numerators and denominators of the other tangents */
    Jet bend;           /* cosine of joint 4 */
    Range link[2][2];   /* cosine and sine of the angles between upper arm and line, and forearm and line */
} Shape;

/* Ranges of the joints over a cell, without their values at the corners. */
typedef struct {
    Range second[DIRECTIONS][JOINTS]; /* second derivatives by platform angle and by arm angle */
    uint8_t smooth[JOINTS];           /* whether neighbouring corners are less than half a turn apart */
    Range value[JOINTS];              /* values; for joints 2, 4 and 6 the positive angle */
} Bends;

/* Positions of a joint from `low` to `high`, modulo whole turns. */
typedef struct {
    double low, high;
} Span;

/* Compute the shape of a flange pose, R (9,) and p (3,) in the carried frame at platform angle zero. */
void compute_shape(const Arm *arm, const double *R, const double *p, double low, double high, Shape *shape);

/* Compute the joints at the corners of an interval's cells, (2, parts, 7): at its low and high end, over equal parts of
   the circle from -pi on; for joints 2, 4 and 6 the positive angle without offset. */
void compute_corners(const Arm *arm, const double *R, const double *p, const Shape *shape, int64_t parts,
                     double *corner);

/* Compute the ranges of the joints over the parts of the circle, (parts,). */
void compute_bends(const Arm *arm, const Shape *shape, int64_t parts, Bends *bends);

/* Compute the spans of all joints over the parts of the circle, (parts, 7); for joints 2, 4 and 6 the positive angles.

   A span is the narrower of the interval around the corners and the range of values. h: half-widths of the cells. */
void compute_spans(int64_t parts, const double h[DIRECTIONS], const double *corner, const Bends *bends, Span *span);

/* Add the deviations of a function below and above its chords over a half-width h, given its second derivative. */
static inline void add_slack(Range second, double h, double *below, double *above)
{
    const double max = second.middle + second.radius, min = second.middle - second.radius;
    *below += max > 0.0 ? 0.5 * max * h * h : 0.0;
    *above += min < 0.0 ? -0.5 * min * h * h : 0.0;
}

#endif
