/* Copyright 2026 sphere_nmpc contributors
   SPDX-License-Identifier: Apache-2.0

   Solves recorded problems again with another build of the solver, and compares the solutions.

       replay LIBRARY RECORD TOLERANCE

   RECORD is a file of recorded_solves.py. Knots over their largest, states and costs may differ by
   TOLERANCE, relative to 1 or their size; numbers of iterations and statuses not at all. One problem
   in a hundred may differ by more: a search that ends after a few iterations amplifies rounding
   where two ways to go on are equally good. */
#include <dlfcn.h>
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "problem.inc"

typedef void solver(int64_t, problem *);

static double *numbers(FILE *file, int64_t count)
{
    double *found = calloc((size_t)count, sizeof *found);
    if (file && fread(found, sizeof *found, (size_t)count, file) != (size_t)count) {
        fprintf(stderr, "replay: the record ends in the middle of a problem\n");
        exit(2);
    }
    return found;
}

/* Return the largest difference of two rows of numbers; infinite where one alone is not finite. */
static double difference(const double *a, const double *b, int64_t count, double scale)
{
    double largest = 0.0;
    for (int64_t i = 0; i < count; i++) {
        if (isfinite(a[i]) != isfinite(b[i])) return INFINITY;
        if (isfinite(a[i])) largest = fmax(largest, fabs(a[i] - b[i]) / fmax(scale, fabs(b[i])));
    }
    return largest;
}

int main(int count, char **arguments)
{
    void *library = count == 4 ? dlopen(arguments[1], RTLD_NOW) : NULL;
    FILE *file = library ? fopen(arguments[2], "rb") : NULL;
    if (!file) {
        fprintf(stderr, "usage: replay LIBRARY RECORD TOLERANCE (%s)\n",
                library ? arguments[2] : count == 4 ? dlerror() : "three arguments");
        return 2;
    }
    solver *solve[2];
    int64_t (*workspace)(int64_t);
    *(void **)&solve[0] = dlsym(library, "solve_least_squares");
    *(void **)&solve[1] = dlsym(library, "solve_minimum_time");
    *(void **)&workspace = dlsym(library, "hold_workspace");
    if (*(int64_t *)dlsym(library, "hold_layout") != LAYOUT) {
        fprintf(stderr, "replay: the library has another layout of problems\n");
        return 2;
    }
    const double tolerance = atof(arguments[3]);
    double largest = 0.0, distance;
    int64_t kind, solved = 0, wrong = 0;
    problem p, recorded;
    while (fread(&kind, sizeof kind, 1, file) == 1) {
        if (fread(&recorded, sizeof recorded, 1, file) != 1) return 2;
        const int64_t n = recorded.intervals;
        p = recorded;
        p.durations = numbers(file, n);
        p.lower = numbers(file, 2 * n);
        p.upper = numbers(file, 2 * n);
        p.start = numbers(file, 2 * n);
        p.inputs = numbers(NULL, 2 * (n + 1));
        p.states = numbers(NULL, 9 * (n + 1));
        p.workspace = numbers(NULL, workspace(n));
        recorded.inputs = numbers(file, 2 * (n + 1));
        recorded.states = numbers(file, 9 * (n + 1));
        solve[kind](1, &p);
        distance = difference(p.inputs, recorded.inputs, 2 * (n + 1), p.input_scale);
        distance = fmax(distance, difference(p.states, recorded.states, 9 * (n + 1), 1.0));
        distance = fmax(distance, difference(&p.cost, &recorded.cost, 1, 1.0));
        largest = fmax(largest, distance);
        solved++;
        if (!(distance <= tolerance) || p.iterations != recorded.iterations
            || p.status != recorded.status) {
            if (wrong++ < 10)
                fprintf(stderr, "problem %lld: N %lld, differs by %.2g; iterations %lld (%lld), "
                        "status %lld (%lld)\n", (long long)solved, (long long)n, distance,
                        (long long)p.iterations, (long long)recorded.iterations,
                        (long long)p.status, (long long)recorded.status);
        }
        double *arrays[] = {p.durations, p.lower, p.upper, p.start, p.inputs, p.states,
                            p.workspace, recorded.inputs, recorded.states};
        for (size_t i = 0; i < sizeof arrays / sizeof *arrays; i++)
            free(arrays[i]);
    }
    printf("%lld problems solved again; they differ by %.2g at most, %lld by more than %g or in "
           "their iterations\n", (long long)solved, largest, (long long)wrong, tolerance);
    return 100 * wrong > solved || solved == 0;
}
