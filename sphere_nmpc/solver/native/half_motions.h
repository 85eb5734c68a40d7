/* Copyright 2026 sphere_nmpc contributors
 * SPDX-License-Identifier: Apache-2.0
 *
 * Many half motions at once, from the start or back from the goal, in single precision: guesses
 * need no more. solver/half_motions.py explains the method and has it in plain form.
 */
#define LANES 16

typedef float lanes __attribute__((vector_size(4 * LANES), aligned(4), may_alias));

static inline lanes load(const float *at)
{
    return *(const lanes *)at;
}

/* The angular velocity in world axes: `world_rate` of model/dynamics.py without momentum. */
static inline void rates(const lanes *q, lanes u0, lanes u1, const float *p, lanes *rate)
{
    const lanes w = q[0], x = q[1], y = q[2], z = q[3];
    const float upright = 1 / (1 - p[2]), more = p[2] / p[3] - 1;
    const lanes z0 = 2 * (x * z + w * y), z1 = 2 * (y * z - w * x), z2 = 1 - 2 * (x * x + y * y);
    const lanes a = (1 - 2 * (y * y + z * z)) * u0 + 2 * (x * y - w * z) * u1;
    const lanes b = 2 * (x * y + w * z) * u0 + (1 - 2 * (x * x + z * z)) * u1;
    const lanes c = upright * (2 * (x * z - w * y) * u0 + 2 * (y * z + w * x) * u1);
    const lanes shared = more * (z0 * a + z1 * b + z2 * c)
                         / (1 + more * (z0 * z0 + z1 * z1 + upright * z2 * z2));
    rate[0] = -p[1] * (a - z0 * shared);
    rate[1] = -p[1] * (b - z1 * shared);
    rate[2] = -p[1] * (c - upright * z2 * shared);
}

/* The quaternion of the rotation vector (a, b, c) times q. */
static inline void turned(const lanes *q, lanes a, lanes b, lanes c, lanes *result)
{
    const lanes s = 0.25f * (a * a + b * b + c * c), w = q[0], x = q[1], y = q[2], z = q[3];
    const lanes cosine = 1 - s / 2 * (1 - s / 12 * (1 - s / 30 * (1 - s / 56)));
    const lanes sine = 0.5f * (1 - s / 6 * (1 - s / 20 * (1 - s / 42 * (1 - s / 72))));
    a *= sine, b *= sine, c *= sine;
    result[0] = w * cosine - x * a - y * b - z * c;
    result[1] = x * cosine + w * a + z * b - y * c;
    result[2] = y * cosine + w * b + x * c - z * a;
    result[3] = z * cosine + w * c + y * a - x * b;
}

/* One step of model/integrator.py's `cf4_step` from `q`; x and y of `place` move along. */
static inline void half_step(lanes *q, lanes *place, const lanes *u, const lanes *next, float h,
                             const float *p)
{
    const float half = 0.5f * h, k = h / 12;
    const lanes m0 = 0.5f * (u[0] + next[0]), m1 = 0.5f * (u[1] + next[1]);
    lanes r[4][3], q2[4], q3[4], first[3], second[3];
    rates(q, u[0], u[1], p, r[0]);
    turned(q, half * r[0][0], half * r[0][1], half * r[0][2], q2);
    rates(q2, m0, m1, p, r[1]);
    turned(q, half * r[1][0], half * r[1][1], half * r[1][2], q3);
    rates(q3, m0, m1, p, r[2]);
    for (int c = 0; c < 3; c++)
        first[c] = h * (r[2][c] - 0.5f * r[0][c]);
    turned(q2, first[0], first[1], first[2], q3);
    rates(q3, next[0], next[1], p, r[3]);
    for (int c = 0; c < 3; c++) {
        const lanes middle = 2 * (r[1][c] + r[2][c]);
        first[c] = k * (middle + 3 * r[0][c] - r[3][c]);
        second[c] = k * (middle - r[0][c] + 3 * r[3][c]);
    }
    place[0] += p[0] * (first[1] + second[1]);
    place[1] -= p[0] * (first[0] + second[0]);
    turned(q, first[0], first[1], first[2], q2);
    turned(q2, second[0], second[1], second[2], q);
}

typedef int32_t choices __attribute__((vector_size(4 * LANES)));

static inline lanes chosen(choices first, lanes a, lanes b)
{
    return (lanes)((first & (choices)a) | (~first & (choices)b));
}

static inline lanes clipped(lanes x, lanes low, lanes high)
{
    const lanes raised = chosen(x < low, low, x);
    return chosen(raised > high, high, raised);
}

/* Integral from 0 to t of a signal that is one until time a, minus one until b and one again. */
static inline lanes integral(float t, lanes a, lanes b)
{
    const lanes zero = a - a, at = zero + fabsf(t);
    return at - 2 * clipped(at - a, zero, at) + 2 * clipped(at - b, zero, at);
}

/* States, (levels + 1) x 6 x count, of `count` half motions from the first of them, which are given,
 * and rotor speeds `begin` on, the first knot from which the speeds stay at their limits, and which
 * of the four corners that is. `signals`, 6 x count: signs of both rotors, first and second switch of
 * the first [s], of the second. A rotor takes the time `ramp` from rest to its limit. `count` is a
 * multiple of LANES. */
void hold_half_motions(int64_t count, int64_t levels, double period, double ramp, double limit,
                       const double *constants, const double *begin,
                       const float *signals, float *states, int32_t *steady, int32_t *corners)
{
    const float p[4] = {(float)constants[0], (float)constants[1], (float)constants[2],
                        (float)constants[3]};
    const float r = (float)ramp, most = (float)limit;
    for (int64_t i = 0; i < count; i += LANES) {
        lanes place[2], q[4], u[2], since = load(signals + i), change = since - since;
        since = change;
        change += most * (float)(period / ramp);
        for (int c = 0; c < 2; c++) {
            place[c] = load(states + c * count + i);
            u[c] = since + (float)begin[c];
        }
        for (int c = 0; c < 4; c++)
            q[c] = load(states + (2 + c) * count + i);
        for (int64_t level = 1; level <= levels; level++) {
            float *at = states + level * 6 * count + i;
            const float t = (float)((double)level * period);
            lanes next[2];
            for (int c = 0; c < 2; c++) {
                const lanes a = load(signals + (2 + 2 * c) * count + i);
                const lanes b = load(signals + (3 + 2 * c) * count + i);
                const lanes mean = (integral(t + r, a, b) - integral(t - r, a, b)) / (2 * r);
                next[c] = most * load(signals + c * count + i) * mean;
                next[c] = clipped(next[c], u[c] - change, u[c] + change);
                const lanes full = change - change + 0.999f * most, now = full - full + (float)level;
                since = chosen((next[c] < full) & (next[c] > -full), now + 1.0f, since);
            }
            half_step(q, place, u, next, (float)period, p);
            for (int c = 0; c < 2; c++) {
                u[c] = next[c];
                *(lanes *)(at + c * count) = place[c];
            }
            for (int c = 0; c < 4; c++)
                *(lanes *)(at + (2 + c) * count) = q[c];
        }
        for (int j = 0; j < LANES; j++) {
            steady[i + j] = (int32_t)fmaxf(since[j], 1.0f);
            corners[i + j] = 2 * (u[0][j] > 0) + (u[1][j] > 0);
        }
    }
}

/* The nearest of `count` states, 6 x stride, to one: squared distance, its index in `*which`. Both
 * signs of a quaternion count as the same. */
static float nearest(const float *x, int64_t count, int64_t stride, const float *states,
                     float turn_weight, int64_t *which)
{
    float least[LANES], smallest = INFINITY;
    int32_t index[LANES];
    for (int k = 0; k < LANES; k++)
        least[k] = INFINITY, index[k] = 0;
    for (int64_t j = 0; j < count; j += LANES)
        for (int k = 0; k < LANES; k++) {
            const float *y = states + j + k;
            const float dx = y[0] - x[0], dy = y[stride] - x[1];
            const float dot = x[2] * y[2 * stride] + x[3] * y[3 * stride] + x[4] * y[4 * stride]
                              + x[5] * y[5 * stride];
            const float distance = dx * dx + dy * dy - 2 * turn_weight * fabsf(dot);
            const int nearer = distance < least[k];
            least[k] = nearer ? distance : least[k];
            index[k] = nearer ? (int32_t)(j + k) : index[k];
        }
    for (int k = 0; k < LANES; k++)
        if (least[k] < smallest) {
            smallest = least[k];
            *which = index[k];
        }
    return fmaxf(smallest + 2 * turn_weight, 0.0f);
}

/* Collect the states of one side at `level` that are steady at `corner` and within reach of
 * `end`; pad with states far away. Return how many there are, without these. */
static int64_t collect(int64_t count, int64_t level, int64_t corner, const float *states,
                       const int32_t *steady, const int32_t *corners, const double *end,
                       double reach, float *found, int32_t *which)
{
    const float *at = states + level * 6 * count;
    const int64_t stride = count + LANES;
    int64_t n = 0;
    for (int64_t i = 0; i < count; i++) { /* a branch would be mispredicted */
        const float dx = at[i] - (float)end[0], dy = at[count + i] - (float)end[1];
        which[n] = (int32_t)i;
        n += (steady[i] <= level) & (corners[i] == corner)
             & !(dx * dx + dy * dy > (float)(reach * reach));
    }
    for (int c = 0; c < 6; c++)
        for (int64_t i = 0; i < n; i++)
            found[c * stride + i] = at[c * count + which[i]];
    for (int64_t i = n; i < n + LANES; i++)
        for (int c = 0; c < 6; c++)
            found[c * stride + i] = c < 2 ? 1e9f : 0.0f;
    return n;
}

/* For each half motion from the start the best partner from the goal, over motions of `first` to
 * `last` periods in all: its score [s], number of periods and index. It ends where `wanted` scores
 * are lower than any of longer motions. Return the number of pairs that were compared. `memory`
 * has 14 (count + LANES) floats. */
int64_t hold_meet(int64_t count, int64_t first, int64_t last, int64_t wanted, double period,
                  double speed, double turn_weight, const double *start, const double *goal,
                  const float *from_start, const float *from_goal, const int32_t *steady,
                  const int32_t *corners, float *memory, float *scores, int32_t *periods,
                  int32_t *partners)
{
    const int64_t stride = count + LANES;
    float *left = memory, *right = memory + 6 * stride;
    int32_t *of_left = (int32_t *)(memory + 12 * stride), *of_right = of_left + stride;
    int64_t pairs = 0;
    for (int64_t i = 0; i < count; i++)
        scores[i] = INFINITY, periods[i] = 0, partners[i] = 0;
    for (int64_t n = first; n <= last; n++) {
        const int64_t forth = (n + 1) / 2, back = n / 2;
        int64_t lower = 0;
        for (int64_t i = 0; i < count; i++)
            lower += scores[i] <= (float)((double)n * period);
        if (lower >= wanted)
            break;
        for (int64_t corner = 0; corner < 4; corner++) {
            const int64_t many = collect(count, forth, corner, from_start, steady, corners, goal,
                                         speed * period * (double)back, left, of_left);
            const int64_t others = collect(count, back, corner, from_goal, steady + count,
                                           corners + count, start,
                                           speed * period * (double)forth, right, of_right);
            if (others == 0)
                continue;
            pairs += many * others;
            for (int64_t i = 0; i < many; i++) {
                float x[6];
                int64_t which = 0;
                for (int c = 0; c < 6; c++)
                    x[c] = left[c * stride + i];
                const float apart = nearest(x, others, stride, right, (float)turn_weight, &which);
                const float score = (float)((double)n * period) + (float)(1.0 / speed) * sqrtf(apart);
                if (score < scores[of_left[i]]) {
                    scores[of_left[i]] = score;
                    periods[of_left[i]] = (int32_t)n;
                    partners[of_left[i]] = of_right[which];
                }
            }
        }
    }
    return pairs;
}
