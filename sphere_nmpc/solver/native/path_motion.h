/* Copyright 2026 sphere_nmpc contributors
 * SPDX-License-Identifier: Apache-2.0
 *
 * Motion along a path, as in solver/path_motion.py, which explains it.
 */
#define PATH_STEP 0.02 /* longest step of the nominal motion [Rs] */
#define PATH_SHORTEST 1.5e-4 /* shortest one */
#define PATH_CHANGE 0.17 /* change of a rotor's speed by a step [rad a Rs, over c1] */
#define PATH_ANGLE 1e-4 /* by which the shell may turn less or more between two knots [rad] */
#define PATH_ENDED 3e-3 /* distance from the end of the path at which the motion ends [Rs] */

typedef struct {
    double time, speeds[2], way, speed, squared_rate, at, sent[2];
} path_step;

typedef struct {
    int64_t rows;
    double spacing, length, tolerance, turn;
    const double *curve, *constants;
} path_course;

static void law_at(const path_course *c, double way, const double *pose, double *law)
{
    const double share = clip(way / c->spacing, 0.0, (double)(c->rows - 1));
    const int64_t index = share < (double)(c->rows - 2) ? (int64_t)share : c->rows - 2;
    const double rest = share - (double)index, *row = c->curve + 4 * index;
    const double given[3] = {c->turn, way < c->length, c->tolerance};
    double point[4];
    for (int k = 0; k < 4; k++)
        point[k] = (1.0 - rest) * row[k] + rest * row[4 + k];
    path_law(pose + 2, pose, point, given, c->constants, law);
}

static void path_pose(const path_course *c, const double *pose, const double *from,
                      const double *to, double step, double *end)
{
    double moved[2];
    nominal_step_undisturbed(pose + 2, from, to, step, c->constants, NULL, moved, end + 2);
    end[0] = pose[0] + moved[0];
    end[1] = pose[1] + moved[1];
}

/* Nominal motion from a pose at `way` up to `last` [m]; returns the number of its steps. */
static int64_t nominal_motion(const path_course *c, const double *start, double way, double last,
                              int64_t capacity, path_step *steps)
{
    const double length = c->length, radius = c->constants[0];
    const double *end = c->curve + 4 * (c->rows - 1), change = PATH_CHANGE / c->constants[1];
    double pose[6], law[5], next[5], bend[2] = {0.0, 0.0}, step = PATH_STEP;
    int64_t count = 0;
    memcpy(pose, start, sizeof pose);
    law_at(c, way, pose, law);
    for (;;) {
        path_step *here = steps + count;
        const path_step *before = count ? here - 1 : here;
        here->time = count ? before->time + step : 0.0;
        memcpy(here->speeds, law, sizeof here->speeds);
        here->way = way;
        here->speed = law[3];
        count++;
        if (count == capacity || (way >= last && last < length))
            break;
        const double left[2] = {end[0] - pose[0], end[1] - pose[1]};
        /* Not hypot, whose symbol an older glibc does not have. */
        if (way >= length && sqrt(left[0] * left[0] + left[1] * left[1]) < PATH_ENDED * radius)
            break;
        double moved[6], ahead;
        step = fmin(2.0 * step, PATH_STEP);
        for (;; step *= 0.5) {
            /* Where the speeds go on to change as they did, or else not at all. */
            const double there[2] = {law[0] + step * bend[0], law[1] + step * bend[1]};
            path_pose(c, pose, law, there, step, moved);
            ahead = fmin(way + radius * step * law[2], length);
            law_at(c, ahead, moved, next);
            const double largest = fmax(fabs(next[0] - law[0]), fabs(next[1] - law[1]));
            if (!(largest > change) || step < PATH_SHORTEST)
                break;
            bend[0] = bend[1] = 0.0;
        }
        path_pose(c, pose, law, next, step, moved);
        for (int k = 0; k < 2; k++)
            bend[k] = (next[k] - law[k]) / step;
        way = ahead;
        memcpy(pose, moved, sizeof pose);
        memcpy(law, next, sizeof law);
    }
    return count;
}

/* Largest squared rate at a step from which one at the next step, up to `most`, can be reached: all
 * of |a_i y - b_i x| <= bound, y <= most. */
static double reachable_from(const double *a, const double *b, double bound, double most, double x)
{
    for (int i = 0; i < 2; i++) {
        if (b[i] * x > most * a[i] + bound)
            x = (most * a[i] + bound) / b[i];
        if (-b[i] * x > bound)
            x = -bound / b[i];
        for (int j = 0; j < 2; j++) {
            const double slope = b[i] * a[j] - b[j] * a[i];
            if (slope * x > bound * (a[i] + a[j]))
                x = bound * (a[i] + a[j]) / slope;
        }
    }
    return x;
}

static void coupling(const path_step *from, const path_step *to, double *a, double *b)
{
    for (int i = 0; i < 2; i++) {
        a[i] = 3.0 * to->speeds[i] - from->speeds[i];
        b[i] = 3.0 * from->speeds[i] - to->speeds[i];
        if (a[i] < 0.0) {
            a[i] = -a[i];
            b[i] = -b[i];
        }
    }
}

/* Fastest squared rates, and the times, of steps within limits [speed, acceleration, speed of the
 * centre] from a rate, to rest. */
static void fastest(path_step *steps, int64_t count, const double *limits, double radius,
                    double rate)
{
    double a[2], b[2];
    for (int64_t k = 0; k < count; k++) {
        path_step *here = steps + k;
        const double largest = fmax(fabs(here->speeds[0]), fabs(here->speeds[1]));
        const double most = fmin(limits[0] / fmax(largest, 1e-6),
                                 limits[2] / (radius * fmax(here->speed, 1e-9)));
        here->squared_rate = k == count - 1 ? 0.0 : most * most;
    }
    for (int64_t k = count - 2; k >= 0; k--) {
        path_step *here = steps + k;
        coupling(here, here + 1, a, b);
        const double bound = 4.0 * limits[1] * (here[1].time - here->time);
        here->squared_rate
            = reachable_from(a, b, bound, here[1].squared_rate, here->squared_rate);
    }
    steps[0].squared_rate = fmin(steps[0].squared_rate, rate * rate);
    steps[0].at = 0.0;
    for (int64_t k = 0; k < count - 1; k++) {
        path_step *here = steps + k, *next = here + 1;
        const double step = next->time - here->time, bound = 4.0 * limits[1] * step;
        double most = next->squared_rate;
        coupling(here, next, a, b);
        for (int i = 0; i < 2; i++)
            if (a[i] * most > b[i] * here->squared_rate + bound)
                most = (b[i] * here->squared_rate + bound) / a[i];
        next->squared_rate = fmax(most, 0.0);
        next->at = here->at + 2.0 * step
                   / fmax(sqrt(here->squared_rate) + sqrt(next->squared_rate), 1e-6);
    }
}

/* Whether the speeds between steps `first` and `last` are nearly those of a straight line. */
static int is_straight(const path_step *first, const path_step *last, double gain)
{
    const double whole = last->at - first->at;
    for (const path_step *here = first + 1; here < last; here++) {
        const double share = (here->at - first->at) / whole;
        for (int i = 0; i < 2; i++) {
            const double line = (1.0 - share) * first->sent[i] + share * last->sent[i];
            if (fabs(here->sent[i] - line) * gain * whole > PATH_ANGLE)
                return 0;
        }
    }
    return 1;
}

/* Write the knots [time, u_1, u_2, way, jump] of the fastest motion along a path; returns
 * their number. `limits` are [speed, acceleration, speed of the centre]. */
int64_t hold_along_path(int64_t rows, double spacing, double tolerance, double turn, double way,
                        double last, const double *curve, const double *constants,
                        const double *limits, const double *pose, const double *speeds,
                        int64_t capacity, path_step *steps, double *knots)
{
    const double length = spacing * (double)(rows - 1);
    const path_course course = {rows, spacing, length, tolerance, turn, curve, constants};
    const int64_t count = nominal_motion(&course, pose, way, last, capacity, steps);
    const double *first = steps[0].speeds;
    const double square = fmax(first[0] * first[0] + first[1] * first[1], 1e-12);
    const double rate = (first[0] * speeds[0] + first[1] * speeds[1]) / square;
    fastest(steps, count, limits, constants[0], fmax(rate, 0.0));
    double jump[2], largest = 0.0;
    for (int i = 0; i < 2; i++) {
        jump[i] = speeds[i] - sqrt(steps[0].squared_rate) * first[i];
        largest = fmax(largest, fabs(jump[i]));
    }
    /* What the speeds in force differ by is lost by half of the acceleration, as far as the limits
     * leave it. */
    const double lost = fmax(2.0 * largest / limits[1], 1e-9);
    for (path_step *here = steps; here < steps + count; here++) {
        const double left = fmax(0.0, 1.0 - here->at / lost);
        for (int i = 0; i < 2; i++) {
            const double sent = sqrt(here->squared_rate) * here->speeds[i] + left * jump[i];
            here->sent[i] = clip(sent, -limits[0], limits[0]);
            if (here > steps) {
                const double before = here[-1].sent[i];
                const double reach = limits[1] * (here->at - here[-1].at);
                here->sent[i] = clip(here->sent[i], before - reach, before + reach);
            }
        }
    }
    if (count > 1) { /* what has not been lost by the end is lost in a longer last step */
        path_step *end = steps + count - 1;
        end->at += fmax(fabs(end->sent[0]), fabs(end->sent[1])) / limits[1];
        end->sent[0] = end->sent[1] = 0.0;
    }
    int64_t found = 0;
    for (int64_t k = 0, before = 0; k < count; k++) {
        const path_step *here = steps + k;
        if (k && k < count - 1 && is_straight(steps + before, here + 1, constants[1]))
            continue;
        const double row[5] = {here->at, here->sent[0], here->sent[1], here->way, largest};
        memcpy(knots + 5 * found++, row, sizeof row);
        before = k;
    }
    return found;
}
