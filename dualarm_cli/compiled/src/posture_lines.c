/* Least times of lines from cells of postures. Method: `bound/cells.py`.

   The circle of arm angles at the target is bisected down to its parts, and the positions of each joint over an arc are
   enclosed by a span. Only parts p that the spans do not exclude are compared closely with the part k in which the line
   starts: over all differences of the arm angle between p - k and p + 1 - k parts, which are bisected as well. */

#include <math.h>
#include <stdlib.h>

#include "posture_lines.h"

/* Bisections of the differences within a part. */
enum { BISECTIONS = 6 };

/* Positions of a joint over one part where the line starts, or over two neighbouring parts at the target.

   At the corners, for both ends of the interval of the platform angle, and ranges of second derivatives. */
typedef struct {
    double at[2][3];
    Range second[DIRECTIONS];
    int smooth;
} Course;

/* Arc of `count` parts of the circle at the target. */
typedef struct {
    int64_t begin, count, child; /* child: index of the first of its two halves, 0 for a single part */
    Span span[JOINTS];
} Arc;

/* Look up the least time of a joint for a distance [s]. */
static double travel_time(const LineLaw *law, int joint, double distance)
{
    const double step = distance * law->steps_per_rad;
    const int64_t last = law->steps - 1, n = step < (double)last ? (int64_t)step : last;
    return law->time[joint * law->steps + n];
}

/* Add whole turns to an angle so that it is nearest to another one. */
static double unwrap(double angle, double reference)
{
    return angle + TURN * nearbyint((reference - angle) / TURN);
}

/* Compute the least distance of a range from the multiples of a turn [rad]. */
static double distance_from_turns(double low, double high)
{
    if (!(high - low < TURN))
        return 0.0;
    const double shift = TURN * nearbyint(0.5 * (low + high) / TURN);
    return fmax(fmax(low - shift, shift - high), 0.0);
}

/* Compute the convex hull of two ranges. */
static Range hull(Range a, Range b)
{
    const double low = fmin(a.middle - a.radius, b.middle - b.radius);
    const double high = fmax(a.middle + a.radius, b.middle + b.radius);
    return (Range){0.5 * (low + high), 0.5 * (high - low)};
}

/* Compute the courses of all joints over `span_parts` parts from each part on, (parts, 7). */
static void compute_courses(const Circle *circle, int span_parts, Course *course)
{
    const int64_t parts = circle->parts;
    for (int64_t k = 0; k < parts; k++)
        for (int joint = 0; joint < JOINTS; joint++) {
            Course *joint_course = course + k * JOINTS + joint;
            const Bends *bends = circle->bends + k, *next = circle->bends + (k + span_parts - 1) % parts;
            joint_course->smooth = bends->smooth[joint] && next->smooth[joint];
            for (int d = 0; d < DIRECTIONS; d++)
                joint_course->second[d] = hull(bends->second[d][joint], next->second[d][joint]);
            for (int side = 0; side < 2; side++)
                for (int i = 0; i <= span_parts; i++) {
                    const double angle = circle->corner[(side * parts + (k + i) % parts) * JOINTS + joint];
                    joint_course->at[side][i] = i      ? unwrap(angle, joint_course->at[side][i - 1])
                                                : side ? unwrap(angle, joint_course->at[0][0])
                                                       : angle;
                }
        }
}

/* Compute the smallest span that holds two spans, one of them moved by whole turns. */
static Span join(Span a, Span b)
{
    if (!(a.low > -INFINITY && b.low > -INFINITY))
        return (Span){-INFINITY, INFINITY};
    const double shift = unwrap(b.low, a.low) - b.low;
    return (Span){fmin(a.low, b.low + shift), fmax(a.high, b.high + shift)};
}

/* Build the tree of arcs, the whole first; return the number of arcs used.

   The span of a part includes the next part because differences of the arm angle extend into it. */
static int64_t build_arcs(const Circle *circle, int64_t begin, int64_t count, Arc *arc, int64_t index, int64_t used)
{
    arc[index] = (Arc){.begin = begin, .count = count};
    if (count == 1) {
        for (int joint = 0; joint < JOINTS; joint++)
            arc[index].span[joint] = join(circle->span[begin * JOINTS + joint],
                                          circle->span[(begin + 1) % circle->parts * JOINTS + joint]);
        return used;
    }
    const int64_t child = used, half = count / 2;
    arc[index].child = child;
    used = build_arcs(circle, begin, half, arc, child, used + 2);
    used = build_arcs(circle, begin + half, count - half, arc, child + 1, used);
    for (int joint = 0; joint < JOINTS; joint++)
        arc[index].span[joint] = join(arc[child].span[joint], arc[child + 1].span[joint]);
    return used;
}

/* Difference of a joint's positions between both ends of the line: linear in the fraction of the difference of the arm
   angle at each corner, with bounds of the deviation below and above. */
typedef struct {
    double start[CORNERS], slope[CORNERS], below, above;
} Gap;

/* Compute the difference of a joint's positions between two courses. */
static Gap compute_gap(const double h[DIRECTIONS], const Course *from, const Course *to)
{
    Gap gap = {.below = 2.0 * ROUNDING, .above = 2.0 * ROUNDING};
    for (int side = 0; side < 2; side++)
        for (int i = 0; i < 2; i++) {
            gap.start[2 * side + i] = to->at[side][i] - from->at[side][i];
            gap.slope[2 * side + i] = to->at[side][i + 1] - to->at[side][i];
        }
    for (int d = 0; d < DIRECTIONS; d++) {
        const Range a = from->second[d], b = to->second[d];
        add_slack((Range){b.middle - a.middle, b.radius + a.radius}, h[d], &gap.below, &gap.above);
    }
    add_slack(to->second[1], h[1], &gap.below, &gap.above);
    if (!from->smooth || !to->smooth)
        gap.below = gap.above = INFINITY;
    return gap;
}

/* Search for the least time of lines from one part. */
typedef struct {
    const LineLaw *law;
    const Course *from; /* courses of all joints where the line starts */
    const Span *span;   /* spans of all joints there */
    double h[DIRECTIONS];
    int free_last;
    /* For the compared part at the target: gaps of all joints, and times between spans of joint 4 and of the triples,
       in the same and in the flipped branch. */
    Gap gap[JOINTS];
    double bend, plain[2], flipped[2];
    double best; /* least time so far [s] */
    double reach[JOINTS]; /* steps of the law from which on a joint takes that time, or infinite */
    int has_bend; /* whether the displacement of joint 4, the same at all arm angles, is known */
} Search;

/* Set the least time so far, and how far the joints get in it. */
static void set_best(Search *search, double best)
{
    search->best = best;
    for (int joint = 0; joint < JOINTS; joint++) {
        const float *time = search->law->time + joint * search->law->steps;
        int64_t low = -1, high = search->law->steps;
        while (high - low > 1) {
            const int64_t middle = (low + high) / 2;
            *(time[middle] >= best ? &high : &low) = middle;
        }
        search->reach[joint] = high < search->law->steps ? (double)high : INFINITY;
    }
}

/* Enclose the displacements of a joint over an interval of the differences of the arm angle. */
static Span gap_span(const Search *search, int joint, double begin, double end)
{
    const Gap *gap = search->gap + joint;
    double low = INFINITY, high = -INFINITY;
    for (int c = 0; c < CORNERS; c++) {
        const double at_begin = gap->start[c] + begin * gap->slope[c], at_end = gap->start[c] + end * gap->slope[c];
        const double lower = at_begin < at_end ? at_begin : at_end, upper = at_begin < at_end ? at_end : at_begin;
        low = lower < low ? lower : low;
        high = upper > high ? upper : high;
    }
    return (Span){low - gap->below, high + gap->above};
}

/* Compute the least time of a joint over an interval of the differences of the arm angle [s]. */
static double gap_time(const Search *search, int joint, double begin, double end)
{
    const Span gap = gap_span(search, joint, begin, end);
    return travel_time(search->law, joint, distance_from_turns(gap.low, gap.high));
}

/* Enclose the displacements of a joint between spans, optionally to its flipped value at the target. */
static Span span_gap(const Search *search, int joint, const Span *span, int flipped)
{
    const Span a = search->span[joint], b = span[joint];
    double low = b.low - a.high, high = b.high - a.low;
    if (flipped && joint % 2) {
        low = -a.high - b.high;
        high = -a.low - b.low;
    } else if (flipped) {
        low += PI;
        high += PI;
    }
    return (Span){low, high};
}

/* Compute the least time of a joint between spans, optionally with its flipped value at the target [s]. */
static double span_time(const Search *search, int joint, const Span *span, int flipped)
{
    const Span gap = span_gap(search, joint, span, flipped);
    return travel_time(search->law, joint, distance_from_turns(gap.low, gap.high));
}

/* Compute the least time of a triple between spans, stopping at the best time so far [s]. */
static double triple_time(const Search *search, int triple, const Span *span, int flipped)
{
    double time = 0.0;
    for (int i = 0; i < 3 && time < search->best; i++)
        if (!search->free_last || JOINT[triple][i] != JOINTS - 1)
            time = fmax(time, span_time(search, JOINT[triple][i], span, flipped));
    return time;
}

/* Check whether the spans exclude a joint's lines faster than the best time, optionally to its flipped value. */
static int is_too_far(const Search *search, int joint, const Span *span, int flipped)
{
    const Span gap = span_gap(search, joint, span, flipped);
    return distance_from_turns(gap.low, gap.high) * search->law->steps_per_rad >= search->reach[joint];
}

/* Check whether the spans exclude lines of a triple faster than the best time. */
static int is_triple_too_far(const Search *search, int triple, const Span *span, int flipped)
{
    for (int i = 0; i < 3; i++)
        if ((!search->free_last || JOINT[triple][i] != JOINTS - 1) &&
            is_too_far(search, JOINT[triple][i], span, flipped))
            return 1;
    return 0;
}

/* Check whether the spans exclude lines faster than the best time. */
static int is_excluded(const Search *search, const Span *span)
{
    if (is_too_far(search, 3, span, 0))
        return 1;
    for (int triple = 0; triple < 2; triple++)
        if (is_triple_too_far(search, triple, span, 0) && is_triple_too_far(search, triple, span, 1))
            return 1;
    return 0;
}

/* Compute the least time over an interval of the differences of the arm angle, stopping at the best time so far [s]. */
static double interval_time(const Search *search, double begin, double end)
{
    double time = fmax(search->bend, gap_time(search, 3, begin, end));
    for (int triple = 0; triple < 2 && time < search->best; triple++) {
        double plain = search->plain[triple];
        for (int i = 0; i < 3 && plain < search->flipped[triple]; i++)
            if (!search->free_last || JOINT[triple][i] != JOINTS - 1)
                plain = fmax(plain, gap_time(search, JOINT[triple][i], begin, end));
        time = fmax(time, fmin(plain, search->flipped[triple]));
    }
    return time;
}

/* Lower the best time to that over an interval of the differences, the faster half first. */
static void lower_best(Search *search, double begin, double end, int bisections)
{
    const double middle = 0.5 * (begin + end);
    const double first = interval_time(search, begin, middle), second = interval_time(search, middle, end);
    for (int i = 0; i < 2; i++) {
        const int half = (first > second) ^ i;
        const double time = half ? second : first;
        if (time >= search->best)
            continue;
        if (bisections > 1)
            lower_best(search, half ? middle : begin, half ? end : middle, bisections - 1);
        else
            search->best = time;
    }
}

/* Compare the parts at both ends: gaps of all joints, and times between spans. */
static void compare_part(Search *search, const Arc *arc, const Course *target)
{
    search->bend = span_time(search, 3, arc->span, 0);
    for (int triple = 0; triple < 2; triple++) {
        search->plain[triple] = triple_time(search, triple, arc->span, 0);
        search->flipped[triple] = triple_time(search, triple, arc->span, 1);
    }
    for (int joint = 0; joint < JOINTS; joint++)
        search->gap[joint] = compute_gap(search->h, search->from + joint, target + arc->begin * JOINTS + joint);
}

/* Lower the best time to that of one part at the target. */
static void search_part(Search *search, const Arc *arc, const Course *target)
{
    compare_part(search, arc, target);
    if (interval_time(search, 0.0, 1.0) < search->best)
        lower_best(search, 0.0, 1.0, BISECTIONS);
}

/* Lower the best time to that of an arc; return the part with the new best time, or `best_part`. */
static int64_t search_arc(Search *search, const Arc *arc, int64_t index, const Course *target, int64_t best_part)
{
    const double before = search->best;
    if (is_excluded(search, arc[index].span))
        return best_part;
    if (arc[index].child) {
        best_part = search_arc(search, arc, arc[index].child, target, best_part);
        return search_arc(search, arc, arc[index].child + 1, target, best_part);
    }
    search_part(search, arc + index, target);
    if (search->best == before)
        return best_part;
    set_best(search, search->best);
    return arc[index].begin;
}

/* Enclose displacements of a joint on lines faster than the best time: less than half a turn. */
static Span within_half_turn(const Search *search, int joint, Span gap)
{
    const double shift = TURN * nearbyint(0.5 * (gap.low + gap.high) / TURN);
    const Span moved = {gap.low - shift, gap.high - shift};
    const int is_sure = moved.low > -PI && moved.high < PI && isfinite(search->reach[joint]);
    return is_sure ? moved : (Span){-INFINITY, INFINITY};
}

/* Enlarge the displacements of a joint that must rise or fall so far. */
static void enlarge(Displacements *displacements, int joint, Span gap)
{
    double *low = displacements->low + joint, *high = displacements->high + joint;
    if (*low <= 0.0 && *high >= 0.0)
        return;
    *low = fmin(*low, gap.low);
    *high = fmax(*high, gap.high);
}

/* Check whether the lines to an arc move a joint at least as far as all others, optionally to its flipped value. */
static int moves_farther(const Search *search, int joint, const Span *span, int flipped, const Displacements *displacements)
{
    const double low = displacements->low[joint], high = displacements->high[joint];
    const Span gap = within_half_turn(search, joint, span_gap(search, joint, span, flipped));
    return (low <= 0.0 || gap.low >= low) && (high >= 0.0 || gap.high <= high);
}

/* Check whether the spans of an arc show that its lines do not enlarge the displacements. */
static int adds_nothing(const Search *search, const Span *span, const Displacements *displacements)
{
    const int is_flippable[2] = {!is_triple_too_far(search, 0, span, 1), !is_triple_too_far(search, 1, span, 1)};
    for (int joint = 0; joint < JOINTS; joint++) {
        const int tells = displacements->low[joint] > 0.0 || displacements->high[joint] < 0.0;
        if (!tells || (joint == 3 && search->has_bend))
            continue;
        if (!moves_farther(search, joint, span, 0, displacements) ||
            (joint != 3 && is_flippable[joint > 3] && !moves_farther(search, joint, span, 1, displacements)))
            return 0;
    }
    return 1;
}

/* Enlarge the displacements by those of the lines to an arc that are faster than the best time. */
static void add_arc(Search *search, const Arc *arc, int64_t index, const Course *target, Displacements *displacements)
{
    if (is_excluded(search, arc[index].span) || adds_nothing(search, arc[index].span, displacements))
        return;
    if (arc[index].child) {
        add_arc(search, arc, arc[index].child, target, displacements);
        add_arc(search, arc, arc[index].child + 1, target, displacements);
        return;
    }
    compare_part(search, arc + index, target);
    if (interval_time(search, 0.0, 1.0) >= search->best)
        return;
    search->has_bend = 1;
    for (int joint = 0; joint < JOINTS; joint++)
        enlarge(displacements, joint, within_half_turn(search, joint, gap_span(search, joint, 0.0, 1.0)));
    for (int triple = 0; triple < 2; triple++)
        for (int i = 0; i < 3 && search->flipped[triple] < search->best; i++) {
            const int joint = JOINT[triple][i];
            enlarge(displacements, joint,
                    within_half_turn(search, joint, span_gap(search, joint, arc[index].span, 1)));
        }
}

/* Forget the displacements of the joints from `first` on. */
static void forget(Displacements *displacements, int first)
{
    for (int joint = first; joint < JOINTS; joint++) {
        displacements->low[joint] = -INFINITY;
        displacements->high[joint] = INFINITY;
    }
}

int lower_line_times(const LineLaw *law, int free_last, const Circle *from, const Circle *to, int64_t refinement,
                     double floor, double *line, Displacements *displacements)
{
    const int64_t parts = from->parts;
    Course *course = malloc(sizeof(Course) * (size_t)(2 * parts * JOINTS)), *target = course + parts * JOINTS;
    Arc *arc = malloc(sizeof(Arc) * (size_t)(2 * parts));
    int64_t *single = malloc(sizeof(int64_t) * (size_t)parts);
    if (!course || !arc || !single) {
        free(course);
        free(arc);
        free(single);
        return 1;
    }
    compute_courses(from, 1, course);
    compute_courses(to, 2, target);
    const int64_t arcs = build_arcs(to, 0, parts, arc, 0, 1);
    for (int64_t i = 0; i < arcs; i++)
        if (!arc[i].child)
            single[arc[i].begin] = i;
    Search search = {.law = law, .h = {from->h[0], from->h[1]}, .free_last = free_last};
    int64_t best_part = 0;
    for (int64_t k = 0; k < parts; k++) {
        /* The best difference of the previous part is a good initial guess. */
        const int64_t guess = (best_part + 1) % parts;
        best_part = guess;
        if (!from->needs_line[k])
            continue;
        Displacements *enclosed = displacements + k / refinement;
        if (floor >= line[k / refinement]) {
            forget(enclosed, 0);
            continue;
        }
        search.from = course + k * JOINTS;
        search.span = from->span + k * JOINTS;
        /* The flipped value of joint 4 at the target bounds the time from above. */
        const double flipped = span_time(&search, 3, arc->span, 1);
        set_best(&search, fmin(line[k / refinement], flipped));
        search_arc(&search, arc, single[guess], target, guess);
        best_part = search_arc(&search, arc, 0, target, guess);
        line[k / refinement] = fmax(search.best, floor);
        if (law->late == 0.0)
            continue;
        set_best(&search, line[k / refinement] + law->late);
        search.has_bend = 0;
        if (flipped < search.best)
            forget(enclosed, 0);
        else {
            add_arc(&search, arc, single[best_part], target, enclosed);
            add_arc(&search, arc, 0, target, enclosed);
        }
        if (free_last)
            forget(enclosed, JOINTS - 1);
    }
    free(course);
    free(arc);
    free(single);
    return 0;
}
