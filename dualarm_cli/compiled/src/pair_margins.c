/* Margins of pairs of a robot's solids in many postures: capsules, boxes and half-spaces. Exact if positive.

   Joint frames, capsules and boxes are those of `collision/tree.py` and `collision/pair_groups.py`. */

#include <math.h>
#include <stdint.h>

/* Joints of a robot: parent joint, column of the position, whether it slides, pose in the parent at zero. */
typedef struct {
    const int64_t *parent, *column, *slides;
    const double *R, *p;
} Tree;

/* Pairs of solids. */
typedef struct {
    /* Joints whose frames are required, each after its parent; without joint 0, the root link. */
    const int64_t *joint;
    /* For each capsule: its joint, and centre and half vector in the joint's frame [m]. */
    const int64_t *capsule_joint;
    const double *center, *half;
    /* For each pair: index of the capsule, kind and index of the second solid, offset subtracted from distances [m],
       the same plus the lengths of the half vectors [m], and its row among the rough pairs, or -1. */
    const int64_t *capsule, *kind, *solid;
    const double *slack, *ball;
    const int64_t *rough;
    /* For each plane: its normal. For each box: its joint, and in the joint's frame its axes as rows, its centre along
       the axes and its half sides [m]. */
    const double *normal;
    const int64_t *box_joint;
    const double *axes, *box_center, *box_half;
    int64_t joints, capsules, pairs, roughs;
} Pairs;

enum { CAPSULE, PLANE, BOX };

typedef struct {
    double R[9], p[3];
} Frame;

typedef struct {
    double middle[3], half[3];
} Segment;

static const double MIN_SQUARED_LENGTH = 1e-18, PARALLEL_TOLERANCE = 1e-12;
static const double CONTACT_DISTANCE = 1e-9; /* largest distance from a box at which penetration is checked [m] */
static const double SLOPE_TOLERANCE = 1e-12; /* relative to the length of the segment */

static double dot(const double *a, const double *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static double clamp(double x, double low, double high) { return x < low ? low : x > high ? high : x; }

/* Compute R x. */
static void rotate(const double *R, const double *x, double *out)
{
    for (int k = 0; k < 3; k++)
        out[k] = dot(R + 3 * k, x);
}

/* Compute R' x. */
static void rotate_back(const double *R, const double *x, double *out)
{
    for (int k = 0; k < 3; k++)
        out[k] = R[k] * x[0] + R[3 + k] * x[1] + R[6 + k] * x[2];
}

/* Compute a joint's frame from its parent's. */
static void joint_frame(const Tree *tree, int64_t joint, const double *q, const Frame *parent, Frame *frame)
{
    const double *step = tree->R + 9 * joint, position = q[tree->column[joint]];
    double R[9];
    rotate(parent->R, tree->p + 3 * joint, frame->p);
    for (int i = 0; i < 3; i++) {
        frame->p[i] += parent->p[i];
        for (int k = 0; k < 3; k++)
            R[3 * i + k] = parent->R[3 * i] * step[k] + parent->R[3 * i + 1] * step[3 + k] +
                           parent->R[3 * i + 2] * step[6 + k];
    }
    const double s = tree->slides[joint] ? 0.0 : sin(position), c = tree->slides[joint] ? 1.0 : cos(position);
    for (int i = 0; i < 3; i++) {
        frame->R[3 * i] = c * R[3 * i] + s * R[3 * i + 1];
        frame->R[3 * i + 1] = c * R[3 * i + 1] - s * R[3 * i];
        frame->R[3 * i + 2] = R[3 * i + 2];
        if (tree->slides[joint])
            frame->p[i] += R[3 * i + 2] * position;
    }
}

/* Compute the distance of two segments, given by centres and half vectors [m].

   The squared distance is a convex quadratic function of both parameters; its minimum is the unconstrained one, clamped
   along each segment in turn ([Ericson2004] 5.1.9). */
double segment_distance(const double *middle, const double *half, const double *other_middle, const double *other_half)
{
    double u[3], v[3], w[3], difference[3];
    for (int k = 0; k < 3; k++) {
        u[k] = -2.0 * half[k];
        v[k] = -2.0 * other_half[k];
        w[k] = middle[k] + half[k] - other_middle[k] - other_half[k];
    }
    const double uu = dot(u, u), vv = dot(v, v), uv = dot(u, v), uw = dot(u, w), vw = dot(v, w);
    const double denominator = uu * vv - uv * uv;
    double s = denominator > PARALLEL_TOLERANCE * uu * vv ? clamp((uv * vw - vv * uw) / denominator, 0.0, 1.0) : 0.0;
    const double t = vv > MIN_SQUARED_LENGTH ? clamp((uv * s + vw) / vv, 0.0, 1.0) : 0.0;
    s = uu > MIN_SQUARED_LENGTH ? clamp((uv * t - uw) / uu, 0.0, 1.0) : 0.0;
    for (int k = 0; k < 3; k++)
        difference[k] = w[k] + s * u[k] - t * v[k];
    return sqrt(dot(difference, difference));
}

/* Compute half the derivative by x of the squared distance of a + x u from a box. */
static double distance_slope(const double *a, const double *u, const double *half, double x)
{
    double sum = 0.0;
    for (int k = 0; k < 3; k++) {
        const double at = a[k] + x * u[k];
        sum += u[k] * (at - clamp(at, -half[k], half[k]));
    }
    return sum;
}

/* Find the x in [0, 1] at which a segment a + x u is nearest to a box, the first or the last one if there are several.

   Half the derivative of the squared distance rises along the segment and is linear between its crossings with the
   planes of the sides: its zero lies between the last negative and the first non-negative derivative at a crossing. */
static double nearest_parameter(const double *a, const double *u, const double *half, int last)
{
    /* Slopes within rounding errors count as zero. */
    const double zero = SLOPE_TOLERANCE * sqrt(dot(u, u));
    double low = 0.0, high = 1.0, at_low = distance_slope(a, u, half, low), at_high = distance_slope(a, u, half, high);
    for (int side = 1; side >= -1; side -= 2)
        for (int k = 0; k < 3; k++) {
            const double x = (side * half[k] - a[k]) / u[k];
            /* Comparisons with NaN are false. */
            if (!(x > low && x < high))
                continue;
            const double at_x = distance_slope(a, u, half, x);
            if (last ? at_x > zero : at_x >= -zero) {
                high = x;
                at_high = at_x;
            } else {
                low = x;
                at_low = at_x;
            }
        }
    if (last ? at_high <= zero : at_high < -zero)
        return high;
    if (last ? at_low > zero : at_low >= -zero)
        return low;
    return at_high > at_low ? low - at_low * (high - low) / (at_high - at_low) : last ? high : low;
}

/* Compute the signed distance of the point a + x u from a box. */
static double point_distance(const double *a, const double *u, const double *half, double x)
{
    double outside = 0.0, deepest = -INFINITY;
    for (int k = 0; k < 3; k++) {
        const double beyond = fabs(a[k] + x * u[k]) - half[k];
        outside += beyond > 0.0 ? beyond * beyond : 0.0;
        deepest = beyond > deepest ? beyond : deepest;
    }
    return sqrt(outside) + (deepest < 0.0 ? deepest : 0.0);
}

/* Compute the distance of a segment from a box about the origin, along the box's axes [m].

   For a segment that passes through the box it is minus the depth of the middle of the part inside. */
double box_distance(const double *middle, const double *to_end, const double *half)
{
    double a[3], u[3];
    for (int k = 0; k < 3; k++) {
        a[k] = middle[k] + to_end[k];
        u[k] = -2.0 * to_end[k];
    }
    const double first = nearest_parameter(a, u, half, 0), distance = point_distance(a, u, half, first);
    if (distance > CONTACT_DISTANCE)
        return distance;
    return point_distance(a, u, half, 0.5 * (first + nearest_parameter(a, u, half, 1)));
}

/* Compute the margin between a capsule and a box, or of the capsule's bounding ball if that is `enough` or more [m]. */
static double box_margin(const Pairs *pairs, int64_t pair, const Frame *frames, const Segment *capsule, double enough)
{
    const int64_t box = pairs->solid[pair];
    const Frame *frame = frames + pairs->box_joint[box];
    const double *axes = pairs->axes + 9 * box, *half = pairs->box_half + 3 * box;
    double difference[3], in_joint[3], middle[3], outside = 0.0;
    for (int k = 0; k < 3; k++)
        difference[k] = capsule->middle[k] - frame->p[k];
    rotate_back(frame->R, difference, in_joint);
    rotate(axes, in_joint, middle);
    for (int k = 0; k < 3; k++) {
        middle[k] -= pairs->box_center[3 * box + k];
        const double beyond = fabs(middle[k]) - half[k];
        outside += beyond > 0.0 ? beyond * beyond : 0.0;
    }
    const double margin = sqrt(outside) - pairs->ball[pair];
    if (margin >= enough)
        return margin;
    double to_end[3];
    rotate_back(frame->R, capsule->half, in_joint);
    rotate(axes, in_joint, to_end);
    return box_distance(middle, to_end, half) - pairs->slack[pair];
}

/* Compute the margin of a pair [m]. */
static double pair_margin(const Pairs *pairs, int64_t pair, const Frame *frames, const Segment *capsules, double enough)
{
    const Segment *capsule = capsules + pairs->capsule[pair];
    if (pairs->kind[pair] == BOX)
        return box_margin(pairs, pair, frames, capsule, enough);
    if (pairs->kind[pair] == PLANE) {
        const double *normal = pairs->normal + 3 * pairs->solid[pair];
        return dot(normal, capsule->middle) - fabs(dot(normal, capsule->half)) - pairs->slack[pair];
    }
    const Segment *second = capsules + pairs->solid[pair];
    double difference[3];
    for (int k = 0; k < 3; k++)
        difference[k] = capsule->middle[k] - second->middle[k];
    const double margin = sqrt(dot(difference, difference)) - pairs->ball[pair];
    if (margin >= enough)
        return margin;
    return segment_distance(capsule->middle, capsule->half, second->middle, second->half) - pairs->slack[pair];
}

/* Compute the least margin of the pairs that are not rough, and the margin of each rough pair, in n postures [m].

   position: of the joints, (n, columns). scene: of each posture, (n,), or null: all pairs are checked.
   first, listed: the pairs of scene s are listed[first[s]] to listed[first[s + 1]], exclusive.
   enough: margins of bounding balls from this value on are not computed more closely [m].
   frames, capsules: buffers for all frames and all capsules.
   least: (n,). rough: (roughs, n), infinite for pairs that the posture's scene does not list. */
void pair_margins(const Tree *tree, const Pairs *pairs, const double *position, int64_t columns, int64_t n,
                  const int64_t *scene, const int64_t *first, const int64_t *listed, double enough, Frame *frames,
                  Segment *capsules, double *least, double *rough)
{
    frames[0] = (Frame){{1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0}, {0.0, 0.0, 0.0}};
    for (int64_t row = 0; row < n; row++) {
        for (int64_t k = 0; k < pairs->joints; k++) {
            const int64_t joint = pairs->joint[k];
            joint_frame(tree, joint, position + row * columns, frames + tree->parent[joint], frames + joint);
        }
        for (int64_t k = 0; k < pairs->capsules; k++) {
            const Frame *frame = frames + pairs->capsule_joint[k];
            rotate(frame->R, pairs->center + 3 * k, capsules[k].middle);
            rotate(frame->R, pairs->half + 3 * k, capsules[k].half);
            for (int i = 0; i < 3; i++)
                capsules[k].middle[i] += frame->p[i];
        }
        least[row] = INFINITY;
        for (int64_t k = 0; k < pairs->roughs; k++)
            rough[k * n + row] = INFINITY;
        const int64_t begin = scene ? first[scene[row]] : 0, end = scene ? first[scene[row] + 1] : pairs->pairs;
        for (int64_t k = begin; k < end; k++) {
            const int64_t pair = scene ? listed[k] : k;
            double margin = pair_margin(pairs, pair, frames, capsules, enough);
            /* NaN counts as contact. */
            margin = isnan(margin) ? -INFINITY : margin;
            if (pairs->rough[pair] >= 0)
                rough[pairs->rough[pair] * n + row] = margin;
            else if (margin < least[row])
                least[row] = margin;
        }
    }
}
