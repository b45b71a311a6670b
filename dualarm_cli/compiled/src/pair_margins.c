/* How far pairs of a robot's solids are apart in many postures: capsules, boxes and half-spaces. Exact where they
   are apart.

   Joint frames, capsules and boxes as `collision/tree.py` and `collision/pair_groups.py` have them. */

#include <math.h>
#include <stdint.h>

typedef struct {
    const int64_t *parent, *column, *slides;
    const double *R, *p;
} Tree;

typedef struct {
    /* The joints whose frames are needed, each after its parent; not joint 0, the root link. */
    const int64_t *joint;
    /* Of each capsule: its joint, middle and half vector there. */
    const int64_t *capsule_joint;
    const double *center, *half;
    /* Of each pair: a capsule; what the other one is, and its number; what the margin is less by; the same and the
       lengths of half vectors; its row among the rough pairs, or -1. */
    const int64_t *one, *kind, *other;
    const double *slack, *ball;
    const int64_t *rough;
    /* Of each plane: its normal. Of each box: its joint, its axes there one a row, its centre along these, half sides. */
    const double *normal;
    const int64_t *box_joint;
    const double *axes, *box_center, *box_half;
    int64_t joints, capsules, pairs, roughs;
} Group;

enum { CAPSULE, PLANE, BOX };

typedef struct {
    double R[9], p[3];
} Frame;

typedef struct {
    double middle[3], half[3];
} Segment;

/* INSIDE: what is nearer to a box may go through it. */
static const double TINY = 1e-18, PARALLEL = 1e-12, INSIDE = 1e-9, SAME = 1e-12;

static double dot(const double *a, const double *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static double clipped(double x, double low, double high) { return x < low ? low : x > high ? high : x; }

static void turned(const double *R, const double *x, double *out)
{
    for (int k = 0; k < 3; k++)
        out[k] = dot(R + 3 * k, x);
}

static void turned_back(const double *R, const double *x, double *out)
{
    for (int k = 0; k < 3; k++)
        out[k] = R[k] * x[0] + R[3 + k] * x[1] + R[6 + k] * x[2];
}

/* A joint's frame from its parent's. */
static void follow(const Tree *tree, int64_t joint, const double *q, const Frame *before, Frame *own)
{
    const double *step = tree->R + 9 * joint, position = q[tree->column[joint]];
    double R[9];
    turned(before->R, tree->p + 3 * joint, own->p);
    for (int i = 0; i < 3; i++) {
        own->p[i] += before->p[i];
        for (int k = 0; k < 3; k++)
            R[3 * i + k] = before->R[3 * i] * step[k] + before->R[3 * i + 1] * step[3 + k] +
                           before->R[3 * i + 2] * step[6 + k];
    }
    const double s = tree->slides[joint] ? 0.0 : sin(position), c = tree->slides[joint] ? 1.0 : cos(position);
    for (int i = 0; i < 3; i++) {
        own->R[3 * i] = c * R[3 * i] + s * R[3 * i + 1];
        own->R[3 * i + 1] = c * R[3 * i + 1] - s * R[3 * i];
        own->R[3 * i + 2] = R[3 * i + 2];
        if (tree->slides[joint])
            own->p[i] += R[3 * i + 2] * position;
    }
}

/* Distance of two segments: the squared distance is a convex quadratic of both parameters, its minimum the free one
   clamped, once along either segment ([Ericson2004] 5.1.9). */
double segment_distance(const double *middle, const double *half, const double *other, const double *other_half)
{
    double u[3], v[3], w[3], apart[3];
    for (int k = 0; k < 3; k++) {
        u[k] = -2.0 * half[k];
        v[k] = -2.0 * other_half[k];
        w[k] = middle[k] + half[k] - other[k] - other_half[k];
    }
    const double uu = dot(u, u), vv = dot(v, v), uv = dot(u, v), uw = dot(u, w), vw = dot(v, w);
    const double denominator = uu * vv - uv * uv;
    double s = denominator > PARALLEL * uu * vv ? clipped((uv * vw - vv * uw) / denominator, 0.0, 1.0) : 0.0;
    const double t = vv > TINY ? clipped((uv * s + vw) / vv, 0.0, 1.0) : 0.0;
    s = uu > TINY ? clipped((uv * t - uw) / uu, 0.0, 1.0) : 0.0;
    for (int k = 0; k < 3; k++)
        apart[k] = w[k] + s * u[k] - t * v[k];
    return sqrt(dot(apart, apart));
}

/* Half the derivative of the squared distance of a + x u from a box. */
static double slope(const double *a, const double *u, const double *half, double x)
{
    double sum = 0.0;
    for (int k = 0; k < 3; k++) {
        const double at = a[k] + x * u[k];
        sum += u[k] * (at - clipped(at, -half[k], half[k]));
    }
    return sum;
}

/* Where along a segment a + x u it is nearest to a box; of several places the first or the last one.

   Half the derivative of the squared distance along the segment rises, and is linear between the places where the segment
   crosses the planes of the sides: it is zero on the straight line between the last of them where it is negative and the
   first where it is not. */
static double nearest(const double *a, const double *u, const double *half, int last)
{
    /* Slopes that rounding alone may make are none. */
    const double zero = SAME * sqrt(dot(u, u));
    double low = 0.0, high = 1.0, at_low = slope(a, u, half, low), at_high = slope(a, u, half, high);
    for (int side = 1; side >= -1; side -= 2)
        for (int k = 0; k < 3; k++) {
            const double x = (side * half[k] - a[k]) / u[k];
            /* Comparisons with NaN are false. */
            if (!(x > low && x < high))
                continue;
            const double there = slope(a, u, half, x);
            if (last ? there > zero : there >= -zero) {
                high = x;
                at_high = there;
            } else {
                low = x;
                at_low = there;
            }
        }
    if (last ? at_high <= zero : at_high < -zero)
        return high;
    if (last ? at_low > zero : at_low >= -zero)
        return low;
    return at_high > at_low ? low - at_low * (high - low) / (at_high - at_low) : last ? high : low;
}

/* Signed distance of a point a + x u from a box. */
static double from_point(const double *a, const double *u, const double *half, double x)
{
    double outside = 0.0, deepest = -INFINITY;
    for (int k = 0; k < 3; k++) {
        const double beyond = fabs(a[k] + x * u[k]) - half[k];
        outside += beyond > 0.0 ? beyond * beyond : 0.0;
        deepest = beyond > deepest ? beyond : deepest;
    }
    return sqrt(outside) + (deepest < 0.0 ? deepest : 0.0);
}

/* Distance of a segment from a box about the origin, in its axes; of one that goes through it minus the depth of the middle
   of what is inside. */
double box_distance(const double *middle, const double *to_end, const double *half)
{
    double a[3], u[3];
    for (int k = 0; k < 3; k++) {
        a[k] = middle[k] + to_end[k];
        u[k] = -2.0 * to_end[k];
    }
    const double first = nearest(a, u, half, 0), distance = from_point(a, u, half, first);
    if (distance > INSIDE)
        return distance;
    return from_point(a, u, half, 0.5 * (first + nearest(a, u, half, 1)));
}

/* Margin of a capsule from a box; from a ball around the capsule where that shows more than enough. */
static double from_box(const Group *group, int64_t pair, const Frame *frames, const Segment *capsule, double enough)
{
    const int64_t box = group->other[pair];
    const Frame *frame = frames + group->box_joint[box];
    const double *axes = group->axes + 9 * box, *half = group->box_half + 3 * box;
    double apart[3], seen[3], middle[3], outside = 0.0;
    for (int k = 0; k < 3; k++)
        apart[k] = capsule->middle[k] - frame->p[k];
    turned_back(frame->R, apart, seen);
    turned(axes, seen, middle);
    for (int k = 0; k < 3; k++) {
        middle[k] -= group->box_center[3 * box + k];
        const double beyond = fabs(middle[k]) - half[k];
        outside += beyond > 0.0 ? beyond * beyond : 0.0;
    }
    const double margin = sqrt(outside) - group->ball[pair];
    if (margin >= enough)
        return margin;
    double to_end[3];
    turned_back(frame->R, capsule->half, seen);
    turned(axes, seen, to_end);
    return box_distance(middle, to_end, half) - group->slack[pair];
}

static double margin_of(const Group *group, int64_t pair, const Frame *frames, const Segment *capsules, double enough)
{
    const Segment *one = capsules + group->one[pair];
    if (group->kind[pair] == BOX)
        return from_box(group, pair, frames, one, enough);
    if (group->kind[pair] == PLANE) {
        const double *normal = group->normal + 3 * group->other[pair];
        return dot(normal, one->middle) - fabs(dot(normal, one->half)) - group->slack[pair];
    }
    const Segment *other = capsules + group->other[pair];
    double apart[3];
    for (int k = 0; k < 3; k++)
        apart[k] = one->middle[k] - other->middle[k];
    const double margin = sqrt(dot(apart, apart)) - group->ball[pair];
    if (margin >= enough)
        return margin;
    return segment_distance(one->middle, one->half, other->middle, other->half) - group->slack[pair];
}

/* Puts the least margins of the pairs that are not rough into `least` (n), and those of rough ones into `rough`, shape
   (rough pairs, n), for n postures of so many columns. In a posture of scene s those pairs count that are listed from
   first[s] to first[s + 1]; all of them where no scenes are given. There is room for all frames and all capsules. */
void pair_margins(const Tree *tree, const Group *group, const double *position, int64_t columns, int64_t n,
                  const int64_t *scene, const int64_t *first, const int64_t *listed, double enough, Frame *frames,
                  Segment *capsules, double *least, double *rough)
{
    frames[0] = (Frame){{1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0}, {0.0, 0.0, 0.0}};
    for (int64_t row = 0; row < n; row++) {
        for (int64_t k = 0; k < group->joints; k++) {
            const int64_t joint = group->joint[k];
            follow(tree, joint, position + row * columns, frames + tree->parent[joint], frames + joint);
        }
        for (int64_t k = 0; k < group->capsules; k++) {
            const Frame *frame = frames + group->capsule_joint[k];
            turned(frame->R, group->center + 3 * k, capsules[k].middle);
            turned(frame->R, group->half + 3 * k, capsules[k].half);
            for (int i = 0; i < 3; i++)
                capsules[k].middle[i] += frame->p[i];
        }
        least[row] = INFINITY;
        for (int64_t k = 0; k < group->roughs; k++)
            rough[k * n + row] = INFINITY;
        const int64_t begin = scene ? first[scene[row]] : 0, end = scene ? first[scene[row] + 1] : group->pairs;
        for (int64_t k = begin; k < end; k++) {
            const int64_t pair = scene ? listed[k] : k;
            double margin = margin_of(group, pair, frames, capsules, enough);
            /* Nothing is known to be free of what is not a number. */
            margin = isnan(margin) ? -INFINITY : margin;
            if (group->rough[pair] >= 0)
                rough[group->rough[pair] * n + row] = margin;
            else if (margin < least[row])
                least[row] = margin;
        }
    }
}
