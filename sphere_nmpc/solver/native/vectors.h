/* Copyright 2026 sphere_nmpc contributors
 * SPDX-License-Identifier: Apache-2.0
 *
 * Vector registers of the instruction set. A tangent holds the derivatives along the 8
 * directions of one interval (its quaternion and its two knots) in 1, 2 or 4 registers, a wide
 * tangent those along 11 directions (the momentum, too) in as many as that takes.
 * A structure of registers and not one long vector: without AVX-512 GCC keeps those in memory.
 */
#if defined(__AVX512F__)
#if !defined(__clang__)
/* Scheduling before register allocation overlaps the long dependency chains of the step, which is a
 * quarter faster with 32 registers; with 16 it spills and gains nothing. */
#pragma GCC optimize("schedule-insns", "sched-pressure")
#endif
#define WIDTH 8
#define PARTS(DO) DO(a)
#define WIDE_PARTS(DO) DO(a) DO(b)
#define FITTED_PARTS(DO) DO(a) DO(b)
#elif defined(__AVX__)
#define WIDTH 4
#define PARTS(DO) DO(a) DO(b)
#define WIDE_PARTS(DO) DO(a) DO(b) DO(c)
#define FITTED_PARTS(DO) DO(a) DO(b) DO(c) DO(d)
#else
#define WIDTH 2
#define PARTS(DO) DO(a) DO(b) DO(c) DO(d)
#define WIDE_PARTS(DO) DO(a) DO(b) DO(c) DO(d) DO(e) DO(f)
#define FITTED_PARTS(DO) DO(a) DO(b) DO(c) DO(d) DO(e) DO(f) DO(g) DO(h)
#endif

typedef double vec __attribute__((vector_size(8 * WIDTH)));

#define MEMBER(i) vec i;
typedef struct { PARTS(MEMBER) } tangent;
typedef struct { WIDE_PARTS(MEMBER) } wide_tangent;
typedef struct { FITTED_PARTS(MEMBER) } fitted;

#define ADD(i) x.i += y.i;
#define SUBTRACT(i) x.i -= y.i;
#define SCALE(i) x.i *= factor;
#define NEGATE(i) x.i = -x.i;
#define OPERATIONS(type, width, ALL) \
    static inline type width##_sum(type x, type y) { ALL(ADD) return x; } \
    static inline type width##_difference(type x, type y) { ALL(SUBTRACT) return x; } \
    static inline type width##_scaled(double factor, type x) { ALL(SCALE) return x; } \
    static inline type width##_negative(type x) { ALL(NEGATE) return x; }
OPERATIONS(tangent, narrow, PARTS)
OPERATIONS(wide_tangent, wide, WIDE_PARTS)
OPERATIONS(fitted, fitted, FITTED_PARTS)

/* The operation for tangents of the width of `x`. */
#define OF_WIDTH(x, operation) \
    _Generic((x), tangent: narrow_##operation, wide_tangent: wide_##operation, \
             fitted: fitted_##operation)

#define TANGENT_COPY(name, x) const __typeof__(x) name = x;
#define TANGENT_SUM(name, x, y) const __typeof__(x) name = OF_WIDTH(x, sum)(x, y);
#define TANGENT_DIFFERENCE(name, x, y) const __typeof__(x) name = OF_WIDTH(x, difference)(x, y);
#define TANGENT_SCALED(name, factor, x) const __typeof__(x) name = OF_WIDTH(x, scaled)(factor, x);
#define TANGENT_NEGATIVE(name, x) const __typeof__(x) name = OF_WIDTH(x, negative)(x);
