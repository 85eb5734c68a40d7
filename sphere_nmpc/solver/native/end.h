/* Copyright 2026 sphere_nmpc contributors
 * SPDX-License-Identifier: Apache-2.0
 *
 * The end of a plan: the speeds of its last knot, u_f + (R(q_d)^T h)_1,2 with the momentum h there;
 * `End` in solver/problem.py explains them.
 */
/* Axes x and y of the body at an orientation, in the world. */
static void body_axes(const double *q, double (*axes)[3])
{
    axes[0][0] = 1.0 - 2.0 * (q[2] * q[2] + q[3] * q[3]);
    axes[0][1] = 2.0 * (q[1] * q[2] + q[0] * q[3]);
    axes[0][2] = 2.0 * (q[1] * q[3] - q[0] * q[2]);
    axes[1][0] = 2.0 * (q[1] * q[2] - q[0] * q[3]);
    axes[1][1] = 1.0 - 2.0 * (q[1] * q[1] + q[3] * q[3]);
    axes[1][2] = 2.0 * (q[2] * q[3] + q[0] * q[1]);
}

/* Component of u_f. */
static double end_speed(const problem *p, int component)
{
    return p->end == END_STATE ? p->end_speeds[component] : 0.0;
}

/* Fix the last knot to the speeds of the end, within its bounds, with the momentum that there is
 * after `duration` of the slope's torque. A speed that is not a number becomes a bound. */
static void fix_end(problem *p, double duration)
{
    double *lower = p->lower + 2 * (p->intervals - 1), *upper = p->upper + 2 * (p->intervals - 1);
    const double *h = p->state + 6, *slope = p->torques;
    double body[2][3];
    body_axes(p->goal + 2, body);
    for (int c = 0; c < 2; c++) {
        const double held = body[c][0] * (h[0] + duration * slope[0])
                            + body[c][1] * (h[1] + duration * slope[1]) + body[c][2] * h[2];
        lower[c] = upper[c] = fmin(fmax(end_speed(p, c) + held, lower[c]), upper[c]);
    }
}
