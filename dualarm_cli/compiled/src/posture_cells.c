/* Cells of (platform angle, arm angle, branch) that together hold every posture of a flange pose that stands in the
   world: `bound/cells.py` explains the enclosures. */

#include <math.h>
#include <stdint.h>
#include <stdlib.h>

#include "srs.h"

enum { CORNERS = 4, MOST_VARIANTS = 1 << JOINTS };

static const double SINGULAR = 1e-3, ROUNDING = 1e-6, APART = 2.0;

/* Intervals of the platform angle; `rates` are the rows of `ShapeRates`: distance_low, distance_high, sin_upper,
   sin_fore, shoulder_first, shoulder_second, wrist_first, wrist_second. */
typedef struct {
    const int64_t *cell; /* platform cell of each, ascending */
    const double *low, *high, *rates[8], *line;
    int64_t count;
} Intervals;

/* Joint ranges within limits, of both values of every joint: on one turn, and on a second one where two turns meet the
   limits. */
typedef struct {
    double low[2][JOINTS][2], high[2][JOINTS][2];
    uint8_t meets[2][JOINTS][2];
} Box;

/* Cells as they are found; no more than `most` are written. */
typedef struct {
    int64_t *cell, *branch;
    double *low, *high, *line; /* low and high (most, 8): joints, then platform angle */
    int64_t most, count;
} Cells;

/* The smaller of two bounds; what is not a number tells nothing. */
static double least_of(double one, double other)
{
    return fmin(isnan(one) ? INFINITY : one, other);
}

static void turned(double angle, const double *v, int64_t stride, double *out)
{
    const double c = cos(angle), s = sin(angle);
    out[0] = c * v[0] - s * v[stride];
    out[stride] = s * v[0] + c * v[stride];
    out[2 * stride] = v[2 * stride];
}

/* The curves of the pose from a platform angle, and u, r and t of the arm plane in the carried frame. */
static void seen_from(const Arm *arm, const double *R, const double *p, double angle, Curves *curves,
                      double directions[3][3])
{
    double own[9], point[3];
    for (int k = 0; k < 3; k++)
        turned(-angle, R + k, 3, own + k);
    turned(-angle, p, 1, point);
    curves_of(arm, own, point, curves);
    const double *plane[3] = {curves->u, curves->r, curves->t};
    for (int v = 0; v < 3; v++)
        for (int i = 0; i < 3; i++)
            directions[v][i] = dot(arm->B + 3 * i, plane[v]);
}

/* The arm angle of the middle's reference direction after the smallest rotation in the world. */
static double carried_along(double middle[3][3], double here[3][3], double turn)
{
    double u[3], r[3], t[3], carried[3];
    turned(turn, here[0], 1, u);
    turned(turn, here[1], 1, r);
    turned(turn, here[2], 1, t);
    const double along = dot(middle[1], u) / fmax(1.0 + dot(middle[0], u), 1e-12);
    for (int i = 0; i < 3; i++)
        carried[i] = middle[1][i] - along * (middle[0][i] + u[i]);
    return atan2(dot(carried, t), dot(carried, r));
}

/* The range of an azimuth, and of the same half a turn on. */
static void around(const double corner[CORNERS], double straight, double bent, double low[2], double high[2])
{
    double change = 0.0, least = 0.0, most = 0.0;
    for (int k = 1; k < CORNERS; k++) {
        const double step = corner[k] - corner[k - 1];
        change += step - TURN * nearbyint(step / TURN);
        least = fmin(least, change);
        most = fmax(most, change);
    }
    const double slack = least_of(straight, bent);
    const int known = straight < 0.5 * PI;
    for (int flip = 0; flip < 2; flip++) {
        low[flip] = known ? corner[0] + least - slack + flip * PI : -INFINITY;
        high[flip] = known ? corner[0] + most + slack + flip * PI : INFINITY;
    }
}

/* Cuts a range at a joint's limits. */
static void limited(const Arm *arm, int joint, int flip, double low, double high, Box *box)
{
    const double bottom = arm->lower[joint], top = arm->upper[joint];
    const int bounded = isfinite(bottom) && isfinite(top);
    low -= ROUNDING;
    high += ROUNDING;
    int known = bounded && high - low < TURN, turns = 0, meets[3];
    if (known) {
        /* The nearest turn to the limits' middle: if any turn meets them, it does, or one next to it. */
        const double shift = TURN * nearbyint((0.5 * (bottom + top) - 0.5 * (low + high)) / TURN);
        low += shift;
        high += shift;
        for (int k = 0; k < 3; k++) {
            meets[k] = low + (k - 1) * TURN <= top && high + (k - 1) * TURN >= bottom;
            turns += meets[k];
        }
        known = turns <= (top - bottom <= TURN + ROUNDING ? 2 : 1);
    }
    if (!known) {
        /* Free within the limits. */
        box->low[0][joint][flip] = bottom;
        box->high[0][joint][flip] = top;
        box->meets[0][joint][flip] = 1;
        box->meets[1][joint][flip] = 0;
        return;
    }
    const double turn[2] = {meets[1] ? 0.0 : meets[0] ? -TURN : TURN, meets[0] && meets[1] ? -TURN : TURN};
    for (int k = 0; k < 2; k++) {
        box->low[k][joint][flip] = fmax(low + turn[k], bottom);
        box->high[k][joint][flip] = fmin(high + turn[k], top);
    }
    box->meets[0][joint][flip] = turns > 0;
    box->meets[1][joint][flip] = turns == 2;
}

/* Both values of joint 4 at a distance from shoulder to wrist. */
static double bend_at(const Arm *arm, double distance)
{
    const double upper = arm->upper_arm, fore = arm->fore_arm;
    const double cosine = (distance * distance - upper * upper - fore * fore) / (2.0 * upper * fore);
    return acos(fmin(fmax(cosine, -1.0), 1.0));
}

/* Fills the boxes (parts,) of one interval of the platform angle; corner is room for 2 * parts * 7. */
static void boxes_of(const Arm *arm, const double *R, const double *p, const Intervals *intervals, int64_t i,
                     int64_t parts, int free_last, double *corner, Box *box)
{
    static const int TRIPLES[2][3] = {{0, 1, 2}, {6, 5, 4}};
    const double low = intervals->low[i], high = intervals->high[i];
    const double middle = 0.5 * (low + high), h_phi = 0.5 * (high - low), h_psi = PI / (double)parts;
    double middle_directions[3][3], directions[3][3];
    Curves curves;
    seen_from(arm, R, p, middle, &curves, middle_directions);
    for (int side = 0; side < 2; side++) {
        const double angle = side ? high : low;
        seen_from(arm, R, p, angle, &curves, directions);
        const double shift = carried_along(middle_directions, directions, angle - middle);
        for (int64_t k = 0; k < parts; k++) {
            const double psi = -PI + TURN * (double)k / (double)parts + shift;
            double q[4], theta[2], *own = corner + (side * parts + k) * JOINTS;
            angles_at(arm, &curves, sin(psi), cos(psi), q, theta);
            for (int j = 0; j < 4; j++)
                own[2 * j] = q[j];
            /* Where the first joint of a triple is chosen at will, the middle one may be an ulp below zero. */
            own[1] = fabs(theta[0]);
            own[5] = fabs(theta[1]);
        }
    }
    const double bend[2] = {bend_at(arm, intervals->rates[1][i]), bend_at(arm, intervals->rates[0][i])};
    for (int64_t k = 0; k < parts; k++) {
        const int64_t next = (k + 1) % parts;
        const double *at[CORNERS] = {corner + k * JOINTS, corner + next * JOINTS, corner + (parts + next) * JOINTS,
                                     corner + (parts + k) * JOINTS};
        for (int triple = 0; triple < 2; triple++) {
            const double b = intervals->rates[2 + triple][i];
            const double a_1 = intervals->rates[4 + 2 * triple][i], a_2 = intervals->rates[5 + 2 * triple][i];
            const int joint = TRIPLES[triple][1];
            double least = INFINITY, most = -INFINITY, to_pole = INFINITY;
            for (int c = 0; c < CORNERS; c++) {
                const double theta = at[c][joint];
                least = fmin(least, theta);
                most = fmax(most, theta);
                to_pole = fmin(to_pole, fmin(theta, PI - theta));
            }
            double away = a_1 * h_phi + b * h_psi;
            double s = fmin(sin(fmax(least - away, 0.0)), sin(fmin(most + away, PI)));
            if (!(s > SINGULAR))
                s = 0.0;
            const double slack = least_of(
                away, 0.5 * ((a_2 + a_1 * a_1) * h_phi * h_phi + (b + b * b) * h_psi * h_psi) / s);
            const double bottom = fmax(least - slack, 0.0), top = fmin(most + slack, PI), offset = arm->offset[joint];
            limited(arm, joint, 0, bottom - offset, top - offset, box + k);
            limited(arm, joint, 1, -top - offset, -bottom - offset, box + k);
            /* The elbow's circle carries the link round at rate b, its frame at rate 1. */
            for (int outer = 0; outer < 2; outer++) {
                const int own = TRIPLES[triple][2 * outer];
                const double speed = outer ? 1.0 : b;
                double lows[2] = {-INFINITY, -INFINITY}, highs[2] = {INFINITY, INFINITY};
                if (own != 6 || !free_last) {
                    double round[CORNERS];
                    for (int c = 0; c < CORNERS; c++)
                        round[c] = at[c][own];
                    away = a_1 * h_phi + speed * h_psi;
                    double cap = INFINITY;
                    if (away < to_pole && to_pole > SINGULAR)
                        cap = asin(fmin(sin(away) / sin(to_pole), 1.0));
                    const double bent = 0.5 * ((a_2 / s + 2.0 * a_1 * a_1 / (s * s)) * h_phi * h_phi +
                                               (speed / s + 2.0 * speed * speed / (s * s)) * h_psi * h_psi);
                    around(round, least_of(away / s, cap), bent, lows, highs);
                }
                for (int flip = 0; flip < 2; flip++)
                    limited(arm, own, flip, lows[flip], highs[flip], box + k);
            }
        }
        limited(arm, 3, 0, bend[0] - arm->offset[3], bend[1] - arm->offset[3], box + k);
        limited(arm, 3, 1, -bend[1] - arm->offset[3], -bend[0] - arm->offset[3], box + k);
    }
}

/* What fine cells of one branch and part of the circle are enclosed by, by the turns of their joints. */
typedef struct {
    int turns[MOST_VARIANTS], count;
    double low[MOST_VARIANTS][JOINTS + 1], high[MOST_VARIANTS][JOINTS + 1], line[MOST_VARIANTS], first[JOINTS];
} Group;

static void enclose(Group *group, const double *low, const double *high, double line)
{
    int turns = 0, k = 0;
    for (int joint = 0; joint < JOINTS; joint++) {
        const double middle = 0.5 * (low[joint] + high[joint]);
        if (!group->count)
            group->first[joint] = middle;
        turns |= (fabs(middle - group->first[joint]) > APART) << joint;
    }
    while (k < group->count && group->turns[k] != turns)
        k++;
    if (k == group->count) {
        group->count++;
        group->turns[k] = turns;
        group->line[k] = INFINITY;
        for (int j = 0; j <= JOINTS; j++) {
            group->low[k][j] = INFINITY;
            group->high[k][j] = -INFINITY;
        }
    }
    for (int j = 0; j <= JOINTS; j++) {
        group->low[k][j] = fmin(group->low[k][j], low[j]);
        group->high[k][j] = fmax(group->high[k][j], high[j]);
    }
    group->line[k] = fmin(group->line[k], line);
}

/* All turns of a fine cell: of the joints from one on, the others being chosen. */
static void each_turn(Group *group, const Box *box, int branch, int joint, double *low, double *high, double line)
{
    if (joint == JOINTS) {
        enclose(group, low, high, line);
        return;
    }
    const int flip = flips(joint, branch);
    for (int k = 0; k < 2; k++) {
        if (!box->meets[k][joint][flip])
            continue;
        low[joint] = box->low[k][joint][flip];
        high[joint] = box->high[k][joint][flip];
        each_turn(group, box, branch, joint + 1, low, high, line);
    }
}

static void emit(const Group *group, int64_t cell, int branch, Cells *cells)
{
    int order[MOST_VARIANTS];
    for (int i = 0; i < group->count; i++) {
        int k = i;
        for (; k > 0 && group->turns[order[k - 1]] > group->turns[i]; k--)
            order[k] = order[k - 1];
        order[k] = i;
    }
    for (int i = 0; i < group->count; i++, cells->count++) {
        if (cells->count >= cells->most)
            continue;
        const int64_t n = cells->count;
        cells->cell[n] = cell;
        cells->branch[n] = branch;
        cells->line[n] = group->line[order[i]];
        for (int j = 0; j <= JOINTS; j++) {
            cells->low[(JOINTS + 1) * n + j] = group->low[order[i]][j];
            cells->high[(JOINTS + 1) * n + j] = group->high[order[i]][j];
        }
    }
}

/* Cells of a flange pose, R (9) and p (3) in the carried frame at platform angle zero: fine ones, `finer` times `parts`
   around the circle, enclosed together by platform cell, branch, part of the circle and turn. Returns 0, or 1 without
   memory; cells->count may exceed cells->most, and then is what is needed. */
int posture_cells(const Arm *arm, const double *R, const double *p, const Intervals *intervals, int64_t parts,
                  int64_t finer, int64_t free_last, Cells *cells)
{
    const int64_t fine = parts * finer;
    int64_t most = 1, begin = 0;
    for (int64_t i = 0; i < intervals->count; i++) {
        begin = i && intervals->cell[i] == intervals->cell[i - 1] ? begin : i;
        most = i - begin + 1 > most ? i - begin + 1 : most;
    }
    Box *box = malloc(sizeof(Box) * (size_t)(most * fine));
    double *corner = malloc(sizeof(double) * (size_t)(2 * fine * JOINTS));
    Group *group = malloc(sizeof(Group));
    const int failed = !box || !corner || !group;
    cells->count = 0;
    for (int64_t first = 0, past; !failed && first < intervals->count; first = past) {
        for (past = first; past < intervals->count && intervals->cell[past] == intervals->cell[first]; past++)
            boxes_of(arm, R, p, intervals, past, fine, (int)free_last, corner, box + (past - first) * fine);
        for (int branch = 0; branch < BRANCHES; branch++)
            for (int64_t part = 0; part < parts; part++) {
                group->count = 0;
                for (int64_t i = first; i < past; i++)
                    for (int64_t k = finer * part; k < finer * (part + 1); k++) {
                        const Box *own = box + (i - first) * fine + k;
                        double low[JOINTS + 1], high[JOINTS + 1];
                        int possible = 1;
                        for (int joint = 0; joint < JOINTS; joint++)
                            possible &= own->meets[0][joint][flips(joint, branch)];
                        low[JOINTS] = intervals->low[i];
                        high[JOINTS] = intervals->high[i];
                        if (possible)
                            each_turn(group, own, branch, 0, low, high, intervals->line[i]);
                    }
                emit(group, intervals->cell[first], branch, cells);
            }
    }
    free(box);
    free(corner);
    free(group);
    return failed;
}
