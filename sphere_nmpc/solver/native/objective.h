/* Copyright 2026 sphere_nmpc contributors
 * SPDX-License-Identifier: Apache-2.0
 *
 * Cost, gradient and Gauss-Newton Hessian, as in solver/plain.py.
 *
 * Without a stage cost the Hessian is 2 J^T J of rank 6 plus D, tridiagonal per rotor (input weight
 * and acceleration), and is never formed. With a stage cost the matrix is formed.
 */
static int is_dense(const problem *p)
{
    return p->stage_weight > 0.0;
}

static double clip(double x, double low, double high)
{
    return x < low ? low : x > high ? high : x; /* a NaN stays one */
}

/* Signed excess of knot difference i over its limit, scaled; i counts the 2 N components. */
static double slew_excess(const problem *p, const double *inputs, int64_t i)
{
    const double limit = p->max_acceleration * p->durations[i / 2];
    const double change = inputs[i + 2] - inputs[i];
    return (change - clip(change, -limit, limit)) / p->input_scale;
}

/* Scaled difference of knot component i from the input reference. */
static double input_excess(const problem *p, const double *v, int64_t i)
{
    return v[i] - p->input_reference[i % 2] / p->input_scale;
}

/* Factor on the error of a component of the state. */
static double state_scale(const problem *p, int component)
{
    const double *turn = p->turn_weights;
    return component < 2 ? p->position_scale : fmax(turn[0], fmax(turn[1], turn[2]));
}

/* Time of knot m. */
static double knot_time(const problem *p, int64_t m)
{
    double time = 0.0;
    while (m-- > 0)
        time += p->stretch * p->durations[m];
    return time;
}

/* Scaled error of a component of the state at knot m. */
static double state_residual(const problem *p, const double *states, int64_t m, int component)
{
    double goal = p->goal[component];
    if (component < 2 && p->goal_velocity[component] != 0.0)
        goal += p->goal_velocity[component] * knot_time(p, m);
    return state_scale(p, component) * (states[STATE * m + component] - goal);
}

static double cost_of(const problem *p, const double *v, const double *inputs,
                      const double *states)
{
    const int64_t n = p->intervals;
    double terminal = 0.0, stages = 0.0, effort = 0.0, slew = 0.0;
    for (int k = 0; k < 6; k++) {
        const double error = state_residual(p, states, n, k);
        terminal += error * error;
    }
    if (is_dense(p))
        for (int64_t m = 1; m < n; m++)
            for (int k = 0; k < 6; k++) {
                const double error = state_residual(p, states, m, k);
                stages += error * error;
            }
    for (int64_t i = 0; i < 2 * n; i++) {
        const double excess = input_excess(p, v, i);
        effort += excess * excess;
    }
    for (int64_t i = 0; i < 2 * n; i++) {
        const double excess = slew_excess(p, inputs, i);
        slew += excess * excess;
    }
    return terminal + p->stage_weight * stages + p->input_weight * effort + slew;
}

/* Inputs and states at scaled knots v, and the derivatives of the intervals. */
static void shoot_knots(const problem *p, const double *v, double *inputs, double *states,
                        double *jacobians)
{
    memcpy(inputs, p->input_in_force, sizeof p->input_in_force);
    for (int64_t i = 0; i < 2 * p->intervals; i++)
        inputs[i + 2] = p->input_scale * v[i];
    shoot(p, inputs, states, jacobians);
}

/* Cost, states and the derivatives of the intervals at v; the results of `expand` are kept. */
static double evaluate(const problem *p, const double *v, double *inputs, double *states,
                       double *jacobians)
{
    shoot_knots(p, v, inputs, states, jacobians);
    return cost_of(p, v, inputs, states);
}

static void dense_states_part(const problem *p, workspace *w)
{
    const int64_t n = p->intervals, size = 2 * n;
    memset(w->chain, 0, (size_t)(STATE * size) * sizeof *w->chain);
    memset(w->hessian, 0, (size_t)(size * size) * sizeof *w->hessian);
    for (int64_t m = 0; m < n; m++) {
        const double weight = 2.0 * (m == n - 1 ? 1.0 : p->stage_weight);
        const int64_t limit = 2 * m + 2;
        advance_chain(p, w, m);
        for (int l = 0; l < 6; l++) {
            const double *row = w->chain + l * size;
            const double by_row = weight * state_scale(p, l);
            const double error = by_row * state_residual(p, p->states, m + 1, l);
            for (int64_t i = 0; i < limit; i++) {
                const double factor = by_row * state_scale(p, l) * row[i];
                double *h = w->hessian + i * size;
                w->gradient[i] += error * row[i];
                for (int64_t j = 0; j <= i; j++)
                    h[j] += factor * row[j];
            }
        }
    }
    for (int64_t i = 0; i < size; i++) {
        w->hessian[i * size + i] += w->diagonal[i];
        if (i >= 2)
            w->hessian[i * size + i - 2] += w->subdiagonal[i];
    }
}

/* Terminal Jacobian and its part of the gradient. */
static void sparse_states_part(const problem *p, workspace *w)
{
    double ends[7][ROW] = {{0.0}};
    for (int k = 0; k < 4; k++)
        ends[k][2 + k] = state_scale(p, 2 + k);
    terminal_rows(p, w, (const double(*)[ROW])ends, NULL);
    double error[END];
    for (int l = 0; l < END; l++)
        error[l] = 2.0 * state_residual(p, p->states, p->intervals, l);
    for (int64_t i = 0; i < 2 * p->intervals; i++) {
        double sum = 0.0;
        for (int l = 0; l < END; l++)
            sum += error[l] * w->rows[i * ROW + l];
        w->gradient[i] += sum;
    }
}

/* Largest component of P(v - g) - v; NaN where a component of the gradient is not finite, which the
 * projection onto the bounds could hide. */
static double projected_gradient(const workspace *w, int64_t size)
{
    double largest = 0.0;
    for (int64_t i = 0; i < size; i++) {
        const double v = w->v[i], gradient = w->gradient[i];
        if (!isfinite(gradient))
            return NAN;
        largest = fmax(largest, fabs(clip(v - gradient, w->lower[i], w->upper[i]) - v));
    }
    return largest;
}

/* Gradient, its projection and Gauss-Newton Hessian at the point of the solve from the intervals'
 * derivatives; the form of the Hessian depends on `is_dense`. */
static void expand(problem *p, workspace *w)
{
    const int64_t size = 2 * p->intervals;
    for (int64_t i = 0; i < size; i++) {
        w->diagonal[i] = 2.0 * p->input_weight;
        w->subdiagonal[i] = 0.0;
        w->partial_gradient[i] = 2.0 * p->input_weight * input_excess(p, w->v, i);
    }
    for (int64_t i = 0; i < size; i++) {
        const double excess = slew_excess(p, p->inputs, i);
        if (excess == 0.0)
            continue;
        w->partial_gradient[i] += 2.0 * excess;
        w->diagonal[i] += 2.0;
        if (i < 2)
            continue;
        w->partial_gradient[i - 2] -= 2.0 * excess;
        w->diagonal[i - 2] += 2.0;
        w->subdiagonal[i] = -2.0;
    }
    memcpy(w->gradient, w->partial_gradient, (size_t)size * sizeof *w->gradient);
    (is_dense(p) ? dense_states_part : sparse_states_part)(p, w);
    p->kkt_residual = projected_gradient(w, size);
}
