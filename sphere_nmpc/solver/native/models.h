/* Copyright 2026 sphere_nmpc contributors
 * SPDX-License-Identifier: Apache-2.0
 *
 * The two models, without and with momentum: shooting.h is included for each, and the functions
 * at the end select. Without drift the first one gives the same results in less time.
 */
static int64_t steps_for(double duration, double max_step)
{
    const double steps = ceil(duration / max_step - 1e-6);
    return steps > 1.0 ? (int64_t)steps : 1;
}

#define NAME(function) function##_without_drift
#define TANGENT tangent
#define CARRIED 4 /* the quaternion */
#include "shooting.h"
#undef NAME
#undef TANGENT
#undef CARRIED

#define NAME(function) function##_with_drift
#define TANGENT wide_tangent
#define CARRIED 7 /* quaternion and momentum */
#include "shooting.h"
#undef NAME
#undef TANGENT
#undef CARRIED

/* Whether a drift, [h, s, a], is not zero; true for a NaN. */
static int is_nonzero(const double *drift)
{
    int any = 0;
    for (int i = 0; i < 8; i++)
        any |= drift[i] != 0.0;
    return any;
}

/* States, (N + 1) x 6, and momenta, (N + 1) x 3, at the knots of `inputs`, (N + 1) x 2 [rad/s],
 * from `state` and `drift` on. */
void hold_roll_out(int64_t intervals, double max_step, const double *constants,
                   const double *durations, const double *state, const double *drift,
                   const double *inputs, double *states, double *momenta)
{
    if (is_nonzero(drift)) {
        roll_out_with_drift(intervals, max_step, constants, durations, state, drift, inputs,
                               states, momenta);
        return;
    }
    memset(momenta, 0, (size_t)(3 * intervals + 3) * sizeof *momenta);
    roll_out_without_drift(intervals, max_step, constants, durations, state, drift, inputs, states,
                     momenta);
}

static void shoot(const problem *p, const double *inputs, double *states, double *momenta,
                  double *jacobians)
{
    (p->drifts ? shoot_with_drift : shoot_without_drift)(p, inputs, states, momenta, jacobians);
}

static void terminal_rows(const problem *p, workspace *w)
{
    (p->drifts ? terminal_rows_with_drift : terminal_rows_without_drift)(p, w);
}

static void advance_chain(const problem *p, workspace *w, int64_t m)
{
    (p->drifts ? advance_chain_with_drift : advance_chain_without_drift)(p, w, m);
}
