/* Copyright 2026 sphere_nmpc contributors
 * SPDX-License-Identifier: Apache-2.0
 *
 * Single shooting: the states along a first-order hold, the derivatives of each interval and their
 * chain. models.h includes this file once for each model and defines
 *
 *     NAME(function)  name of a function of that model
 *     TANGENT         type of its derivatives
 *     CARRIED         how many numbers y affect what follows: the quaternion (4), the momentum (3)
 *     DURATION_SEED   that of the duration of a step of a share of the interval, with a comma, if
 *                     the step is differentiated by it
 *
 * The derivatives of an interval have the rows x, y and those of the carried numbers, and the
 * columns [carried at its start, first knot, second knot, duration], the last one only
 * where DURATION_SEED is a seed; the rest of a TANGENT is zero.
 */
#define DIRECTIONS ((int)(sizeof(TANGENT) / sizeof(double)))
#define DERIVATIVE ((2 + CARRIED) * DIRECTIONS)
#define Y_BYTES (CARRIED * sizeof(double))

static void NAME(roll_out)(int64_t intervals, double max_step, const double *constants,
                           const double *torques, const double *durations,
                           const double *inputs, double *states)
{
    for (int64_t m = 0; m < intervals; m++) {
        const double *u = inputs + 2 * m, *x = states + STATE * m;
        const int64_t steps = steps_for(durations[m], max_step);
        const double h = durations[m] / (double)steps;
        double xy[2] = {x[0], x[1]}, y[CARRIED];
        memcpy(y, x + 2, Y_BYTES);
        for (int64_t i = 0; i < steps; i++) {
            const double a = (double)i / (double)steps, b = (double)(i + 1) / (double)steps;
            double here[2], there[2], moved[2], y_end[CARRIED];
            inputs_at(u, a, here);
            inputs_at(u, b, there);
            NAME(nominal_step)(y, here, there, h, constants, torques, moved, y_end);
            xy[0] += moved[0];
            xy[1] += moved[1];
            memcpy(y, y_end, sizeof y);
        }
        memcpy(states + STATE * (m + 1), xy, sizeof xy);
        memset(states + STATE * (m + 1) + 6, 0, 3 * sizeof *states);
        memcpy(states + STATE * (m + 1) + 2, y, Y_BYTES);
    }
}

/* Direction `d` alone. */
static TANGENT NAME(unit)(int d)
{
    const double lanes[16] = {d == 0, d == 1, d == 2, d == 3, d == 4, d == 5, d == 6, d == 7,
                              d == 8, d == 9, d == 10, d == 11};
    TANGENT t;
    memcpy(&t, lanes, sizeof t);
    return t;
}

/* Seeds of the inputs a share `b` of the way from an interval's first knot to its second. */
static void NAME(input_seeds)(const TANGENT *first, const TANGENT *second, double b,
                              TANGENT *seeds)
{
    for (int c = 0; c < 2; c++) {
        TANGENT_SCALED(from_first, 1.0 - b, first[c])
        TANGENT_SCALED(from_second, b, second[c])
        TANGENT_SUM(sum, from_first, from_second)
        seeds[c] = sum;
    }
}

/* Move state `x` over interval m and write the derivatives [knots: per rad/s]. */
static void NAME(shoot_interval)(const problem *p, int64_t m, const double *u, const double *x,
                                 double *x_end, double *jacobian)
{
    const double left_out = m == p->steady_interval ? p->whole_turns : 0.0;
    const double whole = p->stretch * p->durations[m], duration = whole - left_out;
    /* Their number does not depend on the stretch, which the results then depend on smoothly. */
    const int64_t steps = steps_for(p->durations[m] - left_out, p->max_step);
    const double h = duration / (double)steps;
    const TANGENT first[2] = {NAME(unit)(CARRIED), NAME(unit)(CARRIED + 1)};
    const TANGENT second[2] = {NAME(unit)(CARRIED + 2), NAME(unit)(CARRIED + 3)};
    TANGENT_DIFFERENCE(zero, first[0], first[0])
    TANGENT dxy[2] = {zero, zero}, dy[CARRIED];
    double xy[2] = {0.0, 0.0}, y[CARRIED];
    for (int k = 0; k < CARRIED; k++)
        dy[k] = NAME(unit)(k);
    memcpy(y, x + 2, Y_BYTES);
    for (int64_t i = 0; i < steps; i++) {
        const double a = (double)i / (double)steps, b = (double)(i + 1) / (double)steps;
        double here[2], there[2], moved[2], y_end[CARRIED];
        TANGENT d_here[2], d_there[2], d_moved[2], dy_end[CARRIED];
        inputs_at(u, a, here);
        inputs_at(u, b, there);
        NAME(input_seeds)(first, second, a, d_here);
        NAME(input_seeds)(first, second, b, d_there);
        NAME(tangent_step)(y, here, there, h, p->constants, p->torques, dy, d_here, d_there,
                           DURATION_SEED(1.0 / (double)steps) moved, y_end, d_moved, dy_end);
        memcpy(y, y_end, sizeof y);
        memcpy(dy, dy_end, sizeof dy);
        for (int c = 0; c < 2; c++) {
            xy[c] += moved[c];
            TANGENT_SUM(sum, dxy[c], d_moved[c])
            dxy[c] = sum;
        }
    }
    /* What is left out of an interval of steady rolling adds to the way in proportion. */
    const double scale = whole / duration;
    for (int c = 0; c < 2; c++) {
        x_end[c] = x[c] + scale * xy[c];
        TANGENT_SCALED(scaled, scale, dxy[c])
        dxy[c] = scaled;
    }
    memset(x_end + 6, 0, 3 * sizeof *x_end);
    memcpy(x_end + 2, y, Y_BYTES);
    memcpy(jacobian, dxy, sizeof dxy);
    memcpy(jacobian + 2 * DIRECTIONS, dy, sizeof dy);
}

/* States at the knots and the derivatives of all intervals. That takes half as much
 * time again as the states alone, but most trial steps are accepted and then need them. */
static void NAME(shoot)(const problem *p, const double *inputs, double *states, double *jacobians)
{
    memcpy(states, p->state, sizeof p->state);
    for (int64_t m = 0; m < p->intervals; m++)
        NAME(shoot_interval)(p, m, inputs + 2 * m, states + STATE * m, states + STATE * (m + 1),
                             jacobians + m * DERIVATIVE);
}

/* Derivative of the end of interval m by its duration [1/s], as a column of `terminal_rows`. Where
 * the step is not differentiated by it: the motion depends on the products of speed and duration
 * alone, but for the way over whole turns that are left out. */
static void NAME(by_duration)(const problem *p, int64_t m, double (*column)[ROW], double *by)
{
    const double *u = p->inputs + 2 * m, *x = p->states + STATE * m;
    const double left_out = m == p->steady_interval ? p->whole_turns : 0.0;
    const double whole = p->stretch * p->durations[m], duration = whole - left_out;
    if (DIRECTIONS > CARRIED + 4) {
        memcpy(by, column[CARRIED + 4], ROW * sizeof *by);
        return;
    }
    for (int l = 0; l < ROW; l++) {
        by[l] = 0.0;
        for (int c = 0; c < 4; c++)
            by[l] += column[CARRIED + c][l] * u[c] / duration;
    }
    for (int c = 0; c < 2; c++)
        by[c] -= p->position_scale * left_out * (x[STATE + c] - x[c]) / (whole * duration);
}

/* rows_i = d residual / d v_i, backwards, of residuals at the end: `ends` is their derivative by
 * y_N, and that of the first two by xy_N the position's scale. `by_stretch`, if not null, is the derivative
 * by the logarithm of the stretch. */
static void NAME(terminal_rows)(const problem *p, workspace *w, const double (*ends)[ROW],
                                double *by_stretch)
{
    const int64_t n = p->intervals;
    double sensitivity[CARRIED][ROW];
    memcpy(sensitivity, ends, sizeof sensitivity);
    memset(w->rows, 0, (size_t)(2 * n * ROW) * sizeof *w->rows);
    if (by_stretch)
        memset(by_stretch, 0, ROW * sizeof *by_stretch);
    for (int64_t m = n; m-- > 0;) {
        const double *a = w->interval + m * DERIVATIVE;
        double column[CARRIED + 5][ROW];
        for (int d = 0; d < (CARRIED + 5 < DIRECTIONS ? CARRIED + 5 : DIRECTIONS); d++) {
            double sum[ROW] = {p->position_scale * a[d], p->position_scale * a[DIRECTIONS + d]};
            for (int k = 0; k < CARRIED; k++)
                for (int l = 0; l < ROW; l++)
                    sum[l] += a[(2 + k) * DIRECTIONS + d] * sensitivity[k][l];
            memcpy(column[d], sum, sizeof sum);
        }
        memcpy(sensitivity, column, sizeof sensitivity);
        if (by_stretch) {
            double by[ROW];
            NAME(by_duration)(p, m, column, by);
            for (int l = 0; l < ROW; l++)
                by_stretch[l] += p->stretch * p->durations[m] * by[l];
        }
        if (has_tilt(p) && m == p->steady_interval)
            add_tilt_row(p, p->states + STATE * m + 2, sensitivity);
        for (int c = 0; c < 4; c++) {
            const int64_t i = 2 * m - 2 + c; /* the knot at the start, then the one at the end */
            if (i < 0)
                continue;
            for (int l = 0; l < ROW; l++)
                w->rows[i * ROW + l] += p->input_scale * column[CARRIED + c][l];
        }
    }
}

/* chain = d x_{m+1} / d v from that of m, in place, (2 + CARRIED) x 2 N. */
static void NAME(advance_chain)(const problem *p, workspace *w, int64_t m)
{
    const int64_t size = 2 * p->intervals;
    const double *a = w->interval + m * DERIVATIVE;
    double *s = w->chain;
    for (int64_t i = 0; i < 2 * m; i++) {
        double before[CARRIED], after[2 + CARRIED] = {s[i], s[size + i]};
        for (int k = 0; k < CARRIED; k++)
            before[k] = s[(2 + k) * size + i];
        for (int l = 0; l < 2 + CARRIED; l++)
            for (int k = 0; k < CARRIED; k++)
                after[l] += a[l * DIRECTIONS + k] * before[k];
        for (int l = 0; l < 2 + CARRIED; l++)
            s[l * size + i] = after[l];
    }
    for (int c = 0; c < 4; c++)
        if (2 * m - 2 + c >= 0)
            for (int l = 0; l < 2 + CARRIED; l++)
                s[l * size + 2 * m - 2 + c] += p->input_scale * a[l * DIRECTIONS + CARRIED + c];
}

#undef DIRECTIONS
#undef DERIVATIVE
#undef Y_BYTES
#undef DURATION_SEED
