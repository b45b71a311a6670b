/* Joint paths of lines, and rates of the joints along path coordinates. Method: timing/line_profile.py. */

#ifndef PATHS_H
#define PATHS_H

#include <stdint.h>

/* Sampled joint path of a line, and the joint limits. */
typedef struct {
    const double *position;                       /* at equidistant gridpoints, (samples, joints) */
    const double *velocity, *acceleration, *jerk; /* limits, (joints,); jerk limits may be infinite */
    int64_t samples, joints;                      /* at least 8 samples */
} Path;

/* Knots of a joint motion. */
typedef struct {
    double *time;                               /* (knots,) */
    double *position, *velocity, *acceleration; /* (knots, joints) */
} Motion;

enum {
    COORDINATES = 3, /* path coordinates: length, slowness of the dominant joints, slowness from local limits */
    PHASES = 7
};

/* Derivatives of a path at equidistant values of its coordinates. */
typedef struct {
    double *fraction; /* fraction of the path length, (coordinates, samples) */
    double *speed;    /* largest |q'| / velocity limit of the joints, (coordinates, samples) */
    double *rates;    /* q', q'', q''', (coordinates, samples, 3, stride) */
    double *scratch;  /* twice `stride` joints and a few rows of samples */
    int64_t stride;   /* number of joints, padded */
} Measures;

/* State of a profile, scaled or of a joint. */
typedef struct {
    double position, speed, acceleration, jerk;
} State;

/* Peak rates of a profile along one coordinate; scratch holds the peak |acceleration| and |jerk| of each joint. */
typedef struct {
    const Path *path;
    const Measures *measures;
    const double *speed, *rates; /* of the coordinate */
    double velocity;             /* peak fraction of a velocity limit */
} Peaks;

/* Factor on durations, so that rounding cannot push a joint over its limit. */
static const double ROUNDING = 1.0 + 1e-12;

static inline double larger(double a, double b)
{
    return a > b ? a : b;
}

/* Clamp a value to an interval. */
static inline double clamp(double value, double low, double high)
{
    return value < low ? low : value > high ? high : value;
}

/* Integrate a state at constant jerk over dt. */
static inline State advance(State from, double dt)
{
    const double s = from.position, v = from.speed, a = from.acceleration, j = from.jerk;
    return (State){s + dt * (v + dt * (a / 2.0 + dt * j / 6.0)), v + dt * (a + dt * j / 2.0), a + dt * j, j};
}

/* Integrate phases of constant jerk from rest, scaled to distance 1; those of length zero have no jerk.

   state: at the starts of the phases and at the end, (8,). */
void states_of_phases(const double *length, const double *jerk, State *state);

/* Compute the derivatives of a path along all its coordinates. Returns 0, or 1 if out of memory. */
int measure_path(const Path *path, Measures *measures);
/* Free the memory of `measure_path`. */
void free_measures(Measures *measures);

/* Start the peak rates of a profile along a coordinate; they use the scratch of the measures, one profile at a time. */
Peaks start_peaks(const Path *path, const Measures *measures, int64_t coordinate);
/* Include the rates of the joints at one state of the profile. */
void add_state(Peaks *peaks, State state);
/* Compute the least duration of a profile of distance 1 in time 1 from its peak rates [s]. */
double min_duration(const Peaks *peaks);

/* Interpolate a path with a spline at knots of a coordinate, and scale time by the extrema of the spline.

   fraction: of the path length by the coordinate, (samples,). distance: along the coordinate, (knots,).
   end_velocity: of the joints for a profile of distance 1 in time 1, (joints,), or null: at rest.
   motion: its times are given, scaled to [0, 1].
   Returns 0, or 1 if out of memory. */
int spline_along_path(const Path *path, const double *fraction, const double *distance, int64_t knots,
                      const double *end_velocity, Motion motion);

#endif
