/* Copyright 2026 sphere_nmpc contributors
 * SPDX-License-Identifier: Apache-2.0
 *
 * Vector registers of this processor. A tangent holds the derivatives along the 8
 * directions of one interval (its quaternion and its two knots) in 1, 2 or 4 registers.
 * A structure of registers and not one 64-byte vector: without AVX-512 GCC keeps those in memory.
 * With momentum there are 11 directions, and a wide tangent is two tangents.
 */
#if defined(__AVX512F__)
#define WIDTH 8
#elif defined(__AVX__)
#define WIDTH 4
#else
#define WIDTH 2
#endif

typedef double vec __attribute__((vector_size(8 * WIDTH)));

#if WIDTH == 8
#define FOR_PARTS(DO) DO(a)
typedef struct { vec a; } tangent;
#elif WIDTH == 4
#define FOR_PARTS(DO) DO(a) DO(b)
typedef struct { vec a, b; } tangent;
#else
#define FOR_PARTS(DO) DO(a) DO(b) DO(c) DO(d)
typedef struct { vec a, b, c, d; } tangent;
#endif

typedef struct { tangent a, b; } wide_tangent;

static inline tangent narrow_sum(tangent x, tangent y)
{
#define PART(i) x.i += y.i;
    FOR_PARTS(PART)
#undef PART
    return x;
}

static inline tangent narrow_difference(tangent x, tangent y)
{
#define PART(i) x.i -= y.i;
    FOR_PARTS(PART)
#undef PART
    return x;
}

static inline tangent narrow_scaled(double factor, tangent x)
{
#define PART(i) x.i *= factor;
    FOR_PARTS(PART)
#undef PART
    return x;
}

static inline tangent narrow_negative(tangent x)
{
#define PART(i) x.i = -x.i;
    FOR_PARTS(PART)
#undef PART
    return x;
}

static inline wide_tangent wide_sum(wide_tangent x, wide_tangent y)
{
    return (wide_tangent){narrow_sum(x.a, y.a), narrow_sum(x.b, y.b)};
}

static inline wide_tangent wide_difference(wide_tangent x, wide_tangent y)
{
    return (wide_tangent){narrow_difference(x.a, y.a), narrow_difference(x.b, y.b)};
}

static inline wide_tangent wide_scaled(double factor, wide_tangent x)
{
    return (wide_tangent){narrow_scaled(factor, x.a), narrow_scaled(factor, x.b)};
}

static inline wide_tangent wide_negative(wide_tangent x)
{
    return (wide_tangent){narrow_negative(x.a), narrow_negative(x.b)};
}

/* The operation for tangents of the width of `x`. */
#define OF_WIDTH(x, operation) \
    _Generic((x), tangent: narrow_##operation, wide_tangent: wide_##operation)

#define TANGENT_COPY(name, x) const __typeof__(x) name = x;
#define TANGENT_SUM(name, x, y) const __typeof__(x) name = OF_WIDTH(x, sum)(x, y);
#define TANGENT_DIFFERENCE(name, x, y) const __typeof__(x) name = OF_WIDTH(x, difference)(x, y);
#define TANGENT_SCALED(name, factor, x) const __typeof__(x) name = OF_WIDTH(x, scaled)(factor, x);
#define TANGENT_NEGATIVE(name, x) const __typeof__(x) name = OF_WIDTH(x, negative)(x);
