/* Copyright 2026 sphere_nmpc contributors
 * SPDX-License-Identifier: Apache-2.0
 *
 * The Levenberg-Marquardt iteration of solver/plain.py in C, with the same steps; that file explains
 * the method. Nothing is allocated: the caller provides the memory.
 *
 * problem.h and kernels.h are generated, by layout.py and codegen.py. setup.py compiles this file
 * once for each instruction set.
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
#define END 7 /* residuals: 6 state components at the end, and one of the momentum or the tilt */
#define ROW 8 /* these and a right-hand side */

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

#include "problem.h"
#include "vectors.h"
#include "kernels.h"
#include "quadratic_program.h"
#include "workspace.h"
#include "steady.h"
#include "models.h"
#include "objective.h"
#include "bounded_step.h"
#include "minimum_time.h"
#include "half_motions.h"
#include "propagation.h"
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

static void least_squares(problem *p, double began)
{
    workspace w;
    const int64_t size = 2 * p->intervals;
    double damping = p->initial_damping, growth = 2.0;
    int expanded = 0, small = 0;
    prepare(p, &w);
    p->status = CAPPED;
    p->iterations = 0;
    p->kkt_residual = INFINITY;
    p->cost = evaluate(p, w.v, p->inputs, p->states, w.interval);
    if (!isfinite(p->cost))
        p->status = NOT_FINITE;
    while (p->status != NOT_FINITE) {
        if (!expanded) {
            expand(p, &w, w.v, p->inputs, p->states);
            expanded = 1;
            p->kkt_residual = projected_gradient(&w, size);
            if (!isfinite(p->kkt_residual)) {
                p->status = NOT_FINITE;
                break;
            }
            if (small || p->kkt_residual <= p->gradient_tolerance || p->cost <= p->target_cost) {
                p->status = CONVERGED;
                break;
            }
        }
        if (p->iterations >= p->max_iterations)
            break;
        if (p->time_budget < INFINITY && now() - began > p->time_budget) {
            p->status = BUDGET;
            break;
        }
        p->iterations++;
        double value = NAN;
        if (bounded_step(p, &w, damping, p->states)) {
            for (int64_t i = 0; i < size; i++)
                w.trial[i] = clip(w.v[i] + w.step[i], w.lower[i], w.upper[i]);
            value = evaluate(p, w.trial, w.inputs, w.states, w.interval);
        }
        const double decrease = p->cost - value;
        if (isfinite(value) && decrease > 0.0) {
            const double predicted = predicted_decrease(p, &w);
            const double gain = fmin(decrease / fmax(predicted, 1e-300), 1.0);
            small = decrease <= fmax(p->decrease_tolerance * p->cost, p->decrease_floor);
            damping *= fmax(1.0 / 3.0, 1.0 - pow(2.0 * gain - 1.0, 3.0));
            damping = fmax(damping, MIN_DAMPING);
            growth = 2.0;
            accept_trial(p, &w);
            p->cost = value;
            expanded = 0;
        } else {
            damping *= growth;
            growth *= 2.0;
            if (damping > MAX_DAMPING) {
                p->status = STALLED;
                break;
            }
        }
    }
}

void hold_solve(problem *p)
{
    const double began = now();
    (p->error_weight > 0.0 ? minimum_time : least_squares)(p, began);
    /* U (u / U) may differ from u in the last place: a bound is met exactly all the same. */
    for (int64_t i = 0; i < 2 * p->intervals; i++)
        p->inputs[i + 2] = clip(p->inputs[i + 2], p->lower[i], p->upper[i]);
    p->solve_time = now() - began;
}

/* For tests of the derivatives of the minimum-time problem: error (ROW), its derivatives by the
 * scaled knots (2 N x ROW) and by the logarithm of the duration (ROW) at the initial guess. */
void hold_expand_error(problem *p, double *error, double *rows, double *by_duration)
{
    workspace w;
    prepare(p, &w);
    merit_at(p, &w, w.v, p->inputs, p->states, error);
    expand_error(p, &w, by_duration);
    memcpy(rows, w.rows, (size_t)(2 * p->intervals * ROW) * sizeof *rows);
}

/* For tests of the derivatives: cost, gradient (2 N), Hessian (2 N x 2 N) and sensitivities
 * ((N + 1) x 6 x 2 N, by scaled inputs) at the initial guess. */
void hold_expand(problem *p, double *gradient, double *hessian, double *sensitivities)
{
    workspace w;
    const int64_t size = 2 * p->intervals, block = 6 * size;
    prepare(p, &w);
    p->cost = evaluate(p, w.v, p->inputs, p->states, w.interval);
    expand(p, &w, w.v, p->inputs, p->states);
    p->kkt_residual = projected_gradient(&w, size);
    memcpy(gradient, w.gradient, (size_t)size * sizeof *gradient);
    for (int64_t j = 0; j < size; j++) {
        memset(w.step, 0, (size_t)size * sizeof *w.step);
        w.step[j] = 1.0;
        for (int64_t i = 0; i < size; i++) {
            double sum;
            if (is_dense(p)) {
                sum = dense_product(&w, w.step, i, size);
            } else {
                sum = banded_product(&w, w.step, i, size);
                for (int l = 0; l < END; l++)
                    sum += 2.0 * p->terminal_weight * w.rows[i * ROW + l] * w.rows[j * ROW + l];
            }
            hessian[i * size + j] = sum;
        }
    }
    memset(w.chain, 0, (size_t)(STATE * size) * sizeof *w.chain);
    memset(sensitivities, 0, (size_t)block * sizeof *sensitivities);
    for (int64_t m = 0; m < p->intervals; m++) {
        advance_chain(p, &w, m);
        memcpy(sensitivities + (m + 1) * block, w.chain, (size_t)block * sizeof *w.chain);
    }
}
