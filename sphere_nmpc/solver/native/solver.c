/* Copyright 2026 sphere_nmpc contributors
 * SPDX-License-Identifier: Apache-2.0
 *
 * The Levenberg-Marquardt iteration of solver/plain.py in C, with the same steps; that file explains
 * the method. Nothing is allocated: the caller provides the memory.
 *
 * codegen.py generates problem.inc and kernels.inc. setup.py compiles this file once for each
 * instruction set.
 */
#define _POSIX_C_SOURCE 200809L
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>
#include <time.h>

#define MIN_DAMPING 1e-12
#define MAX_DAMPING 1e12
#define BOUND_PASSES 4
#define END 6 /* components of the pose at the end */
#define ROW 8 /* residuals of the terminal error of a minimum-time problem */

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

#include "problem.inc"

/* Whether the time budget of a solve that began at a reading of the clock is used up. */
static int is_late(const problem *p, double began)
{
    return p->time_budget < INFINITY && now() - began > p->time_budget;
}

#include "vectors.h"
#include "kernels.inc"
#include "quadratic_program.h"
#include "workspace.h"
#include "models.h"
#include "objective.h"
#include "end.h"
#include "bounded_step.h"
#include "minimum_time.h"
#include "half_motions.h"
#include "propagation.h"
#include "path_motion.h"
#include "way.h"
#include "clearance.h"

/* Suffix of the library that is the fastest on this processor, see LEVELS in setup.py. */
const char *hold_level(void)
{
#if defined(__x86_64__)
    if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq")
        && __builtin_cpu_supports("avx512vl"))
        return "_avx512";
    if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma"))
        return "_avx2";
#endif
    return "";
}

const int64_t hold_layout = LAYOUT;

#define RUNNING -1

static int64_t status_of(const problem *p, double began, double damping, int small)
{
    if (!isfinite(p->kkt_residual))
        return NOT_FINITE;
    if (small || p->kkt_residual <= p->gradient_tolerance || p->cost <= p->target_cost)
        return CONVERGED;
    if (damping > MAX_DAMPING)
        return STALLED;
    if (p->iterations >= p->max_iterations)
        return CAPPED;
    return is_late(p, began) ? BUDGET : RUNNING;
}

static void least_squares(problem *p, double began)
{
    workspace w;
    const int64_t size = 2 * p->intervals;
    double damping = p->initial_damping, growth = 2.0;
    int small = 0;
    prepare(p, &w, 1);
    p->cost = evaluate(p, w.v, p->inputs, p->states, w.interval);
    if (isfinite(p->cost))
        expand(p, &w);
    while ((p->status = status_of(p, began, damping, small)) == RUNNING) {
        double value = NAN;
        p->iterations++;
        if (bounded_step(p, &w, damping)) {
            for (int64_t i = 0; i < size; i++)
                w.trial[i] = clip(w.v[i] + w.step[i], w.lower[i], w.upper[i]);
            value = evaluate(p, w.trial, w.inputs, w.states, w.interval);
        }
        const double decrease = p->cost - value;
        if (isfinite(value) && decrease > 0.0) {
            const double predicted = predicted_decrease(p, &w);
            const double gain = fmin(decrease / fmax(predicted, 1e-300), 1.0);
            small = decrease <= fmax(p->decrease_tolerance * p->cost, p->decrease_floor);
            const double twice = 2.0 * gain - 1.0;
            damping *= fmax(1.0 / 3.0, 1.0 - twice * twice * twice);
            damping = fmax(damping, MIN_DAMPING);
            growth = 2.0;
            accept_trial(p, &w);
            p->cost = value;
            expand(p, &w);
        } else {
            damping *= growth;
            growth *= 2.0;
        }
    }
}

/* Solve problems one after the other; their time budget is that of all of them. */
static void solve_all(int64_t count, problem *problems, void (*iterate)(problem *, double))
{
    const double first = now();
    for (problem *p = problems; p < problems + count; p++) {
        const double began = now();
        p->disturbed = is_disturbed(p->state, p->torques);
        iterate(p, first);
        /* U (u / U) may differ from u in the last place: a bound is met exactly all the same. */
        for (int64_t i = 0; i < 2 * p->intervals; i++)
            p->inputs[i + 2] = clip(p->inputs[i + 2], p->lower[i], p->upper[i]);
        p->solve_time = now() - began;
    }
}

void solve_least_squares(int64_t count, problem *problems)
{
    solve_all(count, problems, least_squares);
}

void solve_minimum_time(int64_t count, problem *problems)
{
    solve_all(count, problems, minimum_time);
}
