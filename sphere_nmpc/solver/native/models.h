/* Copyright 2026 sphere_nmpc contributors
 * SPDX-License-Identifier: Apache-2.0
 *
 * Two instances of the model: shooting.h is included for each, and the functions at the end
 * select. Without momentum and torques the first one gives the same results in less time.
 */
static int64_t steps_for(double duration, double max_step)
{
    const double steps = ceil(duration / max_step - 1e-6);
    return steps > 1.0 ? (int64_t)steps : 1;
}

/* Inputs at a share of an interval, between its knots u[0], u[1] and u[2], u[3]. */
static inline void inputs_at(const double *u, double share, double *inputs)
{
    inputs[0] = u[0] + (u[2] - u[0]) * share;
    inputs[1] = u[1] + (u[3] - u[1]) * share;
}

/* Whether the tilt is a residual of a minimum-time problem: of the axis about which the sphere rolls
 * in the interval of steady rolling, a . k at its start, k the vertical in body axes. */
static int has_tilt(const problem *p)
{
    return p->steady_interval > 0 && !p->disturbed;
}

/* The tilt at quaternion `q`. */
static double tilt(const problem *p, const double *q)
{
    const double *a = p->steady_axis;
    return 2.0 * (a[0] * (q[1] * q[3] - q[0] * q[2]) + a[1] * (q[2] * q[3] + q[0] * q[1]));
}

/* Add the derivative of the tilt by the quaternion to the last of the ROW residuals. */
static void add_tilt_row(const problem *p, const double *q, double (*sensitivity)[ROW])
{
    const double *a = p->steady_axis;
    sensitivity[0][ROW - 1] += 2.0 * (a[1] * q[1] - a[0] * q[2]);
    sensitivity[1][ROW - 1] += 2.0 * (a[0] * q[3] + a[1] * q[0]);
    sensitivity[2][ROW - 1] += 2.0 * (a[1] * q[3] - a[0] * q[0]);
    sensitivity[3][ROW - 1] += 2.0 * (a[0] * q[1] + a[1] * q[2]);
}

#define NAME(function) function##_undisturbed
#define TANGENT tangent
#define CARRIED 4 /* the quaternion */
#define DURATION_SEED(share)
#include "shooting.h"
#undef NAME
#undef TANGENT
#undef CARRIED

#define NAME(function) function##_disturbed
#define TANGENT wide_tangent
#define CARRIED 7 /* quaternion and momentum */
#define DURATION_SEED(share) (wide_tangent[]){wide_scaled(share, NAME(unit)(CARRIED + 4))},
#include "shooting.h"
#undef NAME
#undef TANGENT
#undef CARRIED

/* Whether there is momentum in a state, or a torque that changes it; true for a NaN. */
static int is_disturbed(const double *state, const double *torques)
{
    int any = 0;
    for (int i = 6; i < STATE; i++)
        any |= state[i] != 0.0;
    for (int i = 0; i < 5; i++)
        any |= torques[i] != 0.0;
    return any;
}

/* `states`, (N + 1) x STATE, at the knots of `inputs`, (N + 1) x 2 [rad/s]; the first is given. */
void hold_roll_out(int64_t intervals, double max_step, const double *constants,
                   const double *torques, const double *durations, const double *inputs,
                   double *states)
{
    (is_disturbed(states, torques) ? roll_out_disturbed : roll_out_undisturbed)(
        intervals, max_step, constants, torques, durations, inputs, states);
}

static void shoot(const problem *p, const double *inputs, double *states, double *jacobians)
{
    (p->disturbed ? shoot_disturbed : shoot_undisturbed)(p, inputs, states, jacobians);
}

static void terminal_rows(const problem *p, workspace *w, const double (*ends)[ROW],
                          double *by_stretch)
{
    (p->disturbed ? terminal_rows_disturbed : terminal_rows_undisturbed)(
        p, w, ends, by_stretch);
}

static void advance_chain(const problem *p, workspace *w, int64_t m)
{
    (p->disturbed ? advance_chain_disturbed : advance_chain_undisturbed)(p, w, m);
}
