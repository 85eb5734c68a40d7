/* Copyright 2026 sphere_nmpc contributors
 * SPDX-License-Identifier: Apache-2.0
 *
 * Vector registers of this processor. A tangent holds the derivatives along the 8
 * directions of one interval (its quaternion and its two knots) in 1, 2 or 4 registers.
 * A structure of registers and not one 64-byte vector: without AVX-512 GCC keeps those in memory.
 */
#if defined(__AVX512F__)
#define WIDTH 8
#elif defined(__AVX__)
#define WIDTH 4
#else
#define WIDTH 2
#endif

#define DIRECTIONS 8

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

static inline tangent tangent_sum(tangent x, tangent y)
{
#define PART(i) x.i += y.i;
    FOR_PARTS(PART)
#undef PART
    return x;
}

static inline tangent tangent_difference(tangent x, tangent y)
{
#define PART(i) x.i -= y.i;
    FOR_PARTS(PART)
#undef PART
    return x;
}

static inline tangent tangent_scaled(double factor, tangent x)
{
#define PART(i) x.i *= factor;
    FOR_PARTS(PART)
#undef PART
    return x;
}

static inline tangent tangent_negative(tangent x)
{
#define PART(i) x.i = -x.i;
    FOR_PARTS(PART)
#undef PART
    return x;
}

#define TANGENT_COPY(name, x) const tangent name = x;
#define TANGENT_SUM(name, x, y) const tangent name = tangent_sum(x, y);
#define TANGENT_DIFFERENCE(name, x, y) const tangent name = tangent_difference(x, y);
#define TANGENT_SCALED(name, factor, x) const tangent name = tangent_scaled(factor, x);
#define TANGENT_NEGATIVE(name, x) const tangent name = tangent_negative(x);
