/* Copyright 2026 sphere_nmpc contributors
 * SPDX-License-Identifier: Apache-2.0
 *
 * Single shooting: the states along a first-order hold and the derivatives of each interval.
 */
static int64_t steps_for(double duration, double max_step)
{
    const double steps = ceil(duration / max_step - 1e-6);
    return steps > 1.0 ? (int64_t)steps : 1;
}

/* States at the knots of `inputs`, (N + 1) x 2 [rad/s], from `state` on: (N + 1) x 6. */
void hold_roll_out(int64_t intervals, double max_step, const double *constants,
                   const double *durations, const double *state, const double *inputs,
                   double *states)
{
    memcpy(states, state, 6 * sizeof *states);
    for (int64_t m = 0; m < intervals; m++) {
        const double *u = inputs + 2 * m, *x = states + 6 * m;
        const int64_t steps = steps_for(durations[m], max_step);
        const double h = durations[m] / (double)steps;
        const double slope[2] = {u[2] - u[0], u[3] - u[1]};
        double xy[2] = {x[0], x[1]}, q[4] = {x[2], x[3], x[4], x[5]};
        for (int64_t i = 0; i < steps; i++) {
            const double a = (double)i / (double)steps, b = (double)(i + 1) / (double)steps;
            const double here[2] = {u[0] + slope[0] * a, u[1] + slope[1] * a};
            const double there[2] = {u[0] + slope[0] * b, u[1] + slope[1] * b};
            double moved[2], q_end[4];
            nominal_step(q, here, there, h, constants, moved, q_end);
            xy[0] += moved[0];
            xy[1] += moved[1];
            memcpy(q, q_end, sizeof q);
        }
        memcpy(states + 6 * m + 6, xy, sizeof xy);
        memcpy(states + 6 * m + 8, q, sizeof q);
    }
}

/* Direction `d` alone. */
static tangent unit(int d)
{
    const double lanes[DIRECTIONS] = {d == 0, d == 1, d == 2, d == 3,
                                      d == 4, d == 5, d == 6, d == 7};
    tangent t;
    memcpy(&t, lanes, sizeof t);
    return t;
}

/* Seeds of the inputs a share `b` of the way from an interval's first knot to its second. */
static void input_seeds(const tangent *first, const tangent *second, double b, tangent *seeds)
{
    for (int c = 0; c < 2; c++)
        seeds[c] = tangent_sum(tangent_scaled(1.0 - b, first[c]), tangent_scaled(b, second[c]));
}

/* Move `x` over interval m and write the 6 x 8 derivative of its end by its quaternion and its two
 * knots [per rad/s]. */
static void shoot_interval(const problem *p, int64_t m, const double *u, const double *x,
                           double *x_end, double *jacobian)
{
    const int64_t steps = steps_for(p->durations[m], p->max_step);
    const double h = p->durations[m] / (double)steps;
    const double slope[2] = {u[2] - u[0], u[3] - u[1]};
    const tangent first[2] = {unit(4), unit(5)}, second[2] = {unit(6), unit(7)};
    const tangent zero = tangent_difference(first[0], first[0]);
    tangent dxy[2] = {zero, zero}, dq[4] = {unit(0), unit(1), unit(2), unit(3)};
    double xy[2] = {x[0], x[1]}, q[4] = {x[2], x[3], x[4], x[5]};
    for (int64_t i = 0; i < steps; i++) {
        const double a = (double)i / (double)steps, b = (double)(i + 1) / (double)steps;
        const double here[2] = {u[0] + slope[0] * a, u[1] + slope[1] * a};
        const double there[2] = {u[0] + slope[0] * b, u[1] + slope[1] * b};
        double moved[2], q_end[4];
        tangent d_here[2], d_there[2], d_moved[2], dq_end[4];
        input_seeds(first, second, a, d_here);
        input_seeds(first, second, b, d_there);
        tangent_step(q, here, there, h, p->constants, dq, d_here, d_there, moved, q_end, d_moved,
                     dq_end);
        memcpy(q, q_end, sizeof q);
        memcpy(dq, dq_end, sizeof dq);
        for (int c = 0; c < 2; c++) {
            xy[c] += moved[c];
            dxy[c] = tangent_sum(dxy[c], d_moved[c]);
        }
    }
    memcpy(x_end, xy, sizeof xy);
    memcpy(x_end + 2, q, sizeof q);
    memcpy(jacobian, dxy, sizeof dxy);
    memcpy(jacobian + 2 * DIRECTIONS, dq, sizeof dq);
}

/* States at the knots and the derivatives of all intervals. That takes half as much time again as
 * the states alone, but most trial steps are accepted and then need the derivatives. */
static void shoot(const problem *p, const double *inputs, double *states, double *jacobians)
{
    memcpy(states, p->state, sizeof p->state);
    for (int64_t m = 0; m < p->intervals; m++)
        shoot_interval(p, m, inputs + 2 * m, states + 6 * m, states + 6 * m + 6,
                       jacobians + m * 6 * DIRECTIONS);
}
