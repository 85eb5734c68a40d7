/* Copyright 2026 sphere_nmpc contributors
 * SPDX-License-Identifier: Apache-2.0
 *
 * Sequential programs for the minimum-time problem, with the steps of solver/minimum_time.py; that
 * file explains the method. The durations of all intervals are stretched by one factor.
 */
#define PROGRAM_TOLERANCE 0.01 /* gap at which a program is solved, of the decrease floor */
#define LARGEST_CHANGE 0.5 /* of a scaled knot in a step */
#define LARGEST_STRETCH 0.15 /* change of the duration in a step */
#define ACCEPTED 0.1 /* share of the predicted decrease from which on a step is accepted ... */
#define CORRECTED 0.5 /* ... and below which a second-order correction is tried */
#define LARGEST_PROXIMAL 1e6

/* Residual of the momentum at the end, h_N, or of the tilt; 0 without either. */
static double last_residual(const problem *p, const double *states)
{
    const double *row = p->momentum_row, *end = states + STATE * p->intervals + 6;
    if (p->disturbed)
        return row[0] * end[0] + row[1] * end[1] + row[2] * end[2];
    return has_tilt(p) ? tilt(p, states + STATE * p->steady_interval + 2) : 0.0;
}

/* Terminal error, ROW residuals: position, vector part of q conj(q_d), speeds of the end, and the
 * momentum there or the tilt. */
static void terminal_error(const problem *p, const double *inputs, const double *states, double *e)
{
    const double *x = states + STATE * p->intervals, *q = x + 2, *g = p->goal + 2;
    e[0] = state_residual(p, states, p->intervals, 0);
    e[1] = state_residual(p, states, p->intervals, 1);
    e[2] = g[0] * q[1] - g[1] * q[0] + g[2] * q[3] - g[3] * q[2];
    e[3] = g[0] * q[2] - g[1] * q[3] - g[2] * q[0] + g[3] * q[1];
    e[4] = g[0] * q[3] + g[1] * q[2] - g[2] * q[1] - g[3] * q[0];
    for (int c = 0; c < 3; c++)
        e[2 + c] *= p->turn_weights[c];
    e[5] = e[6] = 0.0;
    if (p->end != END_FREE) {
        double body[2][3];
        body_axes(g, body);
        for (int c = 0; c < 2; c++)
            e[5 + c] = (inputs[2 * p->intervals + c] - end_speed(p, c) - body[c][0] * x[6]
                        - body[c][1] * x[7] - body[c][2] * x[8])
                       / p->input_scale;
    }
    e[7] = last_residual(p, states);
}

/* Its derivatives by the scaled knots, w->rows, and by the logarithm of the duration, `b`. */
static void expand_error(const problem *p, workspace *w, double *b)
{
    const int64_t size = 2 * p->intervals;
    const double *g = p->goal + 2;
    const double sign[3][4] = {{-g[1], g[0], -g[3], g[2]}, {-g[2], g[3], g[0], -g[1]},
                               {-g[3], -g[2], g[1], g[0]}};
    double ends[7][ROW] = {{0.0}}, body[2][3];
    body_axes(g, body);
    for (int k = 0; k < 4; k++)
        for (int c = 0; c < 3; c++)
            ends[k][2 + c] = p->turn_weights[c] * sign[c][k];
    for (int k = 0; k < 3; k++) {
        for (int c = 0; c < 2; c++)
            ends[4 + k][5 + c] = p->end == END_FREE ? 0.0 : -body[c][k] / p->input_scale;
        ends[4 + k][7] = p->momentum_row[k];
    }
    terminal_rows(p, w, (const double(*)[ROW])ends, b);
    for (int c = 0; c < 2; c++)
        b[c] -= p->position_scale * p->goal_velocity[c] * knot_time(p, p->intervals);
    if (p->end != END_FREE)
        for (int c = 0; c < 2; c++)
            w->rows[(size - 2 + c) * ROW + 5 + c] += 1.0;
    for (int64_t i = 0; i < size; i++)
        if (!(w->lower[i] < w->upper[i]))
            memset(w->rows + i * ROW, 0, ROW * sizeof *w->rows);
}

/* Largest change of a scaled knot from the one before in interval m. */
static double reach_of(const problem *p, int64_t m)
{
    return p->max_acceleration / p->input_scale * p->stretch * p->durations[m];
}

static double knot_before(const problem *p, const double *v, int64_t i)
{
    return i >= 2 ? v[i - 2] : p->input_in_force[i] / p->input_scale;
}

/* Effort at scaled knots `v` and the stretch of p, times its weight. */
static double effort_at(const problem *p, const double *v)
{
    double sum = 0.0;
    for (int64_t i = 0; p->effort_weight > 0.0 && i < 2 * p->intervals; i++) {
        const double share = (v[i] - knot_before(p, v, i)) / reach_of(p, i / 2);
        sum += p->stretch * p->durations[i / 2] * share * share;
    }
    return p->effort_weight * sum;
}

/* Move the knots within the limits of acceleration: those that can be reached from the start, and
 * of these those from which the last one can be reached. If there are none, stretch the time. */
static void keep_acceleration(problem *p, workspace *w)
{
    const int64_t size = 2 * p->intervals;
    double stretch = fmax(1.0, p->least_duration / w->duration);
    for (int64_t i = 0; i < size; i++) {
        const double before = knot_before(p, w->v, i), reach = reach_of(p, i / 2);
        w->v[i] = clip(clip(w->v[i], before - reach, before + reach), w->lower[i], w->upper[i]);
    }
    for (int64_t i = size - 2; i-- > 0;) {
        const double after = w->v[i + 2], reach = reach_of(p, i / 2 + 1);
        w->v[i] = clip(clip(w->v[i], after - reach, after + reach), w->lower[i], w->upper[i]);
    }
    for (int64_t i = 0; i < size; i++)
        stretch = fmax(stretch, fabs(w->v[i] - knot_before(p, w->v, i)) / reach_of(p, i / 2));
    p->stretch = stretch;
}

static double one_norm(const double *e)
{
    double sum = 0.0;
    for (int k = 0; k < ROW; k++)
        sum += fabs(e[k]);
    return sum;
}

/* Merit at scaled knots `v` and the stretch of p, with inputs, states, derivatives and error. */
static double merit_at(problem *p, workspace *w, const double *v, double *inputs, double *states,
                       double *e)
{
    shoot_knots(p, v, inputs, states, w->interval);
    terminal_error(p, inputs, states, e);
    return p->stretch * w->duration + p->error_weight * one_norm(e) + effort_at(p, v);
}

static void set_program(const problem *p, const workspace *w, program *q)
{
    const double mean = w->duration / (double)p->intervals;
    for (int64_t i = 0; i < q->size; i++) {
        const double after = i + 2 < q->size ? p->durations[i / 2 + 1] : 0.0;
        q->down[i] = q->free[i] ? fmax(w->lower[i] - w->v[i], -LARGEST_CHANGE) : -1.0;
        q->up[i] = q->free[i] ? fmin(w->upper[i] - w->v[i], LARGEST_CHANGE) : 1.0;
        q->metric[i] = 0.5 * (p->durations[i / 2] + after) / mean;
        q->change[i] = w->v[i] - knot_before(p, w->v, i);
        q->limit[i] = reach_of(p, i / 2);
        if (q->has_effort)
            q->effort[i] = 2.0 * p->effort_weight * p->stretch * p->durations[i / 2]
                           / (q->limit[i] * q->limit[i]);
    }
    q->s_up = LARGEST_STRETCH;
    q->s_down = fmax(-LARGEST_STRETCH, p->least_duration / (p->stretch * w->duration) - 1.0);
    q->g = p->stretch * w->duration;
    q->w = p->error_weight;
}

/* Merit at the step of the program, with knots w->trial; `p` is left at its stretch. */
static double trial_merit(problem *p, workspace *w, const program *q, double stretch, double *e)
{
    for (int64_t i = 0; i < q->size; i++)
        w->trial[i] = clip(w->v[i] + q->z[i], w->lower[i], w->upper[i]);
    p->stretch = fmax(stretch * (1.0 + q->s), p->least_duration / w->duration);
    return merit_at(p, w, w->trial, w->inputs, w->states, e);
}

/* e + b s + E z of the program's step. */
static void predicted_error(const program *q, const double *e, double *predicted)
{
    for (int k = 0; k < ROW; k++)
        predicted[k] = e[k] + q->b[k] * q->s;
    for (int64_t i = 0; i < q->size; i++)
        for (int k = 0; k < ROW; k++)
            predicted[k] += q->rows[i * ROW + k] * q->z[i];
}

static double squared_step(const program *q)
{
    double sum = 0.0;
    for (int64_t i = 0; i < q->size; i++)
        sum += q->metric[i] * q->z[i] * q->z[i];
    return sum;
}

static void minimum_time(problem *p, double began)
{
    workspace w;
    program q;
    const int64_t size = 2 * p->intervals;
    double error[ROW], in_succession = 0.0;
    prepare(p, &w, !p->disturbed);
    divide_program(&q, w.program, size);
    q.rows = w.rows;
    q.free = w.free;
    q.has_effort = p->effort_weight > 0.0;
    q.r = p->initial_damping;
    q.tolerance = PROGRAM_TOLERANCE * p->decrease_floor;
    for (int64_t i = 0; i < size; i++)
        w.free[i] = w.lower[i] < w.upper[i];
    keep_acceleration(p, &w);
    p->status = CAPPED;
    p->cost = merit_at(p, &w, w.v, p->inputs, p->states, error);
    if (!isfinite(p->cost))
        p->status = NOT_FINITE;
    else if (p->error_weight * one_norm(error) < p->target_cost)
        p->status = CONVERGED;
    else
        expand_error(p, &w, q.b);
    while (p->status == CAPPED && p->iterations < p->max_iterations) {
        if (is_late(p, began)) {
            p->status = BUDGET;
            break;
        }
        p->iterations++;
        const double stretch = p->stretch;
        double linear[ROW], found[ROW];
        set_program(p, &w, &q);
        memcpy(q.e, error, sizeof error);
        if (solve_program(&q) < 0) {
            p->status = STALLED;
            break;
        }
        predicted_error(&q, error, linear);
        double merit = trial_merit(p, &w, &q, stretch, found);
        const double predicted = p->cost - stretch * (1.0 + q.s) * w.duration
                                 - p->error_weight * one_norm(linear) - effort_at(p, w.trial);
        if (!(p->cost - merit >= CORRECTED * predicted)) {
            /* The same program for the error that the step has really led to. */
            const double first_s = q.s, first = merit;
            memcpy(w.step, q.z, (size_t)size * sizeof *q.z);
            for (int k = 0; k < ROW; k++)
                q.e[k] += found[k] - linear[k];
            if (solve_program(&q) >= 0)
                merit = trial_merit(p, &w, &q, stretch, found);
            if (!(merit < first)) {
                memcpy(q.z, w.step, (size_t)size * sizeof *q.z);
                q.s = first_s;
                merit = trial_merit(p, &w, &q, stretch, found);
            }
        }
        const double decrease = p->cost - merit;
        const double curvature = 2.0 * (predicted - decrease) / fmax(squared_step(&q), 1e-12);
        p->kkt_residual = predicted;
        const int small = predicted < p->decrease_floor;
        if (decrease >= ACCEPTED * predicted && decrease > 0.0) {
            accept_trial(p, &w);
            memcpy(error, found, sizeof error);
            p->cost = merit;
            in_succession += 1.0;
            for (int64_t i = 0; i < size; i++)
                q.pull[i] = in_succession / (in_succession + 3.0) * q.z[i];
            q.r = fmin(fmax(curvature, 0.25 * q.r), 4.0 * q.r);
            if (!small)
                expand_error(p, &w, q.b);
        } else {
            p->stretch = stretch;
            in_succession = 0.0;
            memset(q.pull, 0, (size_t)size * sizeof *q.pull);
            q.r = fmin(fmax(2.0 * q.r, curvature), 16.0 * q.r);
        }
        if (small || p->error_weight * one_norm(error) < p->target_cost)
            p->status = CONVERGED;
        else if (!(q.r < LARGEST_PROXIMAL))
            p->status = STALLED;
    }
}
