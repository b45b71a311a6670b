/* Paths of lines and what the joints do along coordinates of them; the method is explained in timing/line_profile.py. */

#ifndef PATHS_H
#define PATHS_H

#include <stdint.h>

typedef struct {
    const double *position;                        /* at equidistant gridpoints, (samples, joints) */
    const double *velocity, *acceleration, *jerk; /* limits, (joints,); that of the jerk may be infinite */
    int64_t samples, joints;                      /* at least 8 samples */
} Path;

typedef struct {
    double *time;                              /* (knots,) */
    double *position, *velocity, *acceleration; /* (knots, joints) */
} Motion;

enum {
    COORDINATES = 3, /* path length, slowness of the deciding joint, slowness by what each place allows */
    PHASES = 7
};

typedef struct {
    double *share; /* share of the path length at equidistant values of each coordinate, (coordinates, samples) */
    double *speed; /* largest |q'| / velocity limit there, (coordinates, samples) */
    double *rates; /* q', q'', q''' there, (coordinates, samples, 3, stride) */
    double *room;  /* for `stride` joints twice and for a few rows of samples */
    int64_t stride;
} Measures;

typedef struct {
    double way, speed, acceleration, jerk;
} State;

/* What the joints needed so far: room holds each one's largest |acceleration|, then each one's largest |jerk|. */
typedef struct {
    const Path *path;
    const Measures *measures;
    const double *speed, *rates; /* of one coordinate */
    double velocity;             /* largest share of a velocity limit */
} Needs;

/* A hair slower, so that rounding cannot push a joint over its limit. */
static const double ROUNDING = 1.0 + 1e-12;

static inline double larger(double one, double other)
{
    return one > other ? one : other;
}

static inline double within(double value, double low, double high)
{
    return value < low ? low : value > high ? high : value;
}

static inline State advanced(State from, double dt)
{
    const double s = from.way, v = from.speed, a = from.acceleration, j = from.jerk;
    return (State){s + dt * (v + dt * (a / 2.0 + dt * j / 6.0)), v + dt * (a + dt * j / 2.0), a + dt * j, j};
}

/* Measures a path along all its coordinates. Returns 0, or 1 without memory; `release` frees what it holds. */
int measure(const Path *path, Measures *own);
void release(Measures *own);

/* Nothing is needed yet along a coordinate; `look` adds one instant of a profile. One at a time uses the measures. */
Needs needs_of(const Path *path, const Measures *measures, int64_t coordinate);
void look(Needs *needs, State at);
/* How long a profile of way 1 in time 1 must take for every limit to hold, of what was looked at. */
double needed_time(const Needs *needs);

/* Puts joints on the path at knots of ways along a coordinate, of shares `share`, and scales time by the extrema of the
   spline through them. Velocities at the end as a profile of way 1 in time 1 has them, null: at rest.
   Returns 0, or 1 without memory. */
int along(const Path *path, const double *share, const double *way, int64_t knots, const double *last, Motion found);

#endif
