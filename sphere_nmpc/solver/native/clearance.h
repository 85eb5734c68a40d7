/* Copyright 2026 sphere_nmpc contributors
   SPDX-License-Identifier: Apache-2.0 */
/* Distance that a motion is certified to keep from what is occupied on a floor. */

/* A floor: distances at the corners of its cells, and where these are. */
typedef struct {
    const float *distances; /* (rows x columns) [m] */
    int64_t rows, columns;
    double x, y, cosine, sine, side; /* first corner [m], heading of the rows, side of a cell [m] */
} floor_corners;

/* Return a lower bound of the distance at a place, from the four corners of its cell; 0 outside. */
static double distance_at(const floor_corners *f, double x, double y)
{
    double dx = x - f->x, dy = y - f->y;
    double u = (dx * f->cosine + dy * f->sine) / f->side;
    double v = (dy * f->cosine - dx * f->sine) / f->side;
    double column = floor(u), row = floor(v), least = 0.0;
    /* Not finite places are outside, too. */
    if (!(column >= 0.0 && row >= 0.0 && column < (double)(f->columns - 1)
          && row < (double)(f->rows - 1)))
        return 0.0;
    const float *corner = f->distances + (int64_t)row * f->columns + (int64_t)column;
    for (int i = 0; i < 2; i++)
        for (int j = 0; j < 2; j++) {
            double across = u - column - j, up = v - row - i;
            double away = sqrt(across * across + up * up);
            double bound = corner[i * f->columns + j] - f->side * away;
            if (bound > least) least = bound;
        }
    return least;
}

/* Return the nearest number of 0, 1 ... last; 0 of what is no number. */
static inline int64_t nearest_of(double value, double last)
{
    double whole = rint(value);
    whole = whole > 0.0 ? whole : 0.0;
    return (int64_t)(whole < last ? whole : last);
}

/* Let half motions end before they collide: from there on their places are infinite.

   `states` are those of `hold_half_motions`, which take place at a displacement `beyond` [m];
   `grid` is as for `hold_clearance`. See `Floor.collided` for the rest. */
void hold_end_before_collisions(int64_t count, int64_t levels, const double *beyond,
                                const float *restrict distances, int64_t rows, int64_t columns,
                                const double *grid, double least, float *restrict states)
{
    const double along = grid[2] / grid[4], across = grid[3] / grid[4];
    const double dx = beyond[0] - grid[0], dy = beyond[1] - grid[1];
    const double last_column = (double)(columns - 1), last_row = (double)(rows - 1);
    /* That of the nearest corner; beyond the edge one of the edge, where it is 0. */
#define DISTANCE(x, y)                                                                             \
    distances[nearest_of((y) * along - (x) * across, last_row) * columns                           \
              + nearest_of((x) * along + (y) * across, last_column)]
    for (int64_t k = 0; k < count; k++)
        least = fmin(least, DISTANCE(states[k] + dx, states[count + k] + dy));
    const float wanted = (float)(least - grid[4]);
    for (int64_t level = 1; level <= levels; level++) {
        float *x = states + 6 * count * level, *y = x + count;
        const float *from_x = x - 6 * count, *from_y = y - 6 * count;
#pragma GCC ivdep
        for (int64_t k = 0; k < count; k++) {
            double to_x = x[k] + dx, to_y = y[k] + dy;
            double half_x = 0.5 * (to_x + from_x[k] + dx), half_y = 0.5 * (to_y + from_y[k] + dy);
            /* Half way as well; from an infinite place on that is beyond the edge. */
            float end = DISTANCE(to_x, to_y), middle = DISTANCE(half_x, half_y);
            float here = end < middle ? end : middle;
            x[k] = here < wanted ? INFINITY : x[k];
            y[k] = here < wanted ? INFINITY : y[k];
        }
    }
#undef DISTANCE
}

static double speeds_of(const double *inputs, const double *state, int is_disturbed)
{
    double speed = sqrt(inputs[0] * inputs[0] + inputs[1] * inputs[1]);
    if (is_disturbed)
        speed += sqrt(state[6] * state[6] + state[7] * state[7] + state[8] * state[8]);
    return speed;
}

/* Certify a motion by samples that are no farther apart than `longest` [s].

   Returns 1 and the distance where it is certified, 0 where closer samples may certify it, and -1
   where they would not. */
static int certify(int64_t intervals, const double *constants, const double *torques,
                   const double *durations, const double *inputs, const double *start,
                   const floor_corners *f, double needed, double radius, double fall, double rate,
                   double longest, int is_disturbed, double *found)
{
    double states[2][STATE], ends[4];
    memcpy(states[1], start, sizeof states[1]);
    double before = distance_at(f, start[0], start[1]), reached = before, least = before;
    int has_enough = before >= needed;
    /* Inside of what is occupied there is no distance that could be kept. */
    if (!(before > 0.0)) return -1;
    double kept = fmin(before, radius), contact = before >= radius ? radius : 0.0;
    for (int64_t m = 0; m < intervals; m++) {
        int64_t parts = (int64_t)fmax(1.0, ceil(durations[m] / longest));
        double step = durations[m] / (double)parts;
        for (int64_t k = 0; k < parts; k++) {
            inputs_at(inputs + 2 * m, (double)k / (double)parts, ends);
            inputs_at(inputs + 2 * m, (double)(k + 1) / (double)parts, ends + 2);
            memcpy(states[0], states[1], sizeof states[0]);
            hold_roll_out(1, INFINITY, constants, torques, &step, ends, states[0]);
            double speeds = speeds_of(ends, states[0], is_disturbed)
                            + speeds_of(ends + 2, states[1], is_disturbed);
            double here = distance_at(f, states[1][0], states[1][1]);
            /* From one sample it falls and to the next one it rises by no more than the way. */
            double between = 0.5 * (before + here - 0.5 * rate * speeds * step);
            if (has_enough) {
                if (here < needed) return -1;
                if (between < needed) return 0;
                least = fmin(least, between);
            } else {
                /* Short of it at the start, whether a path falls is only known at its samples. */
                double known = reached < needed ? here : between;
                reached = fmax(reached, here);
                if (known < fmax(fmin(needed, reached) - fall, kept) || between < contact)
                    return 0;
                least = fmin(least, fmin(here, between));
            }
            before = here;
        }
    }
    *found = least;
    return 1;
}

/* Return the distance [m] that a motion keeps, nan where it is not certified to keep enough.

   `grid` are place x, y [m], cosine and sine of the heading, and side of the cells [m]; `radius` is
   the distance of a contact [m], `rate` the bound of the centre's speed for inputs of length 1
   [m/rad], and `spacings` are the distances of samples [s] that are tried one after the other. */
double hold_clearance(int64_t intervals, const double *constants, const double *torques,
                      const double *durations, const double *inputs, const double *start,
                      const float *distances, int64_t rows, int64_t columns, const double *grid,
                      double needed, double radius, double fall, double rate,
                      const double *spacings, int64_t levels)
{
    floor_corners f = {distances, rows, columns, grid[0], grid[1], grid[2], grid[3], grid[4]};
    int is_disturbed_motion = is_disturbed(start, torques);
    double found = NAN;
    for (int64_t level = 0; level < levels; level++) {
        int result = certify(intervals, constants, torques, durations, inputs, start, &f, needed,
                             radius, fall, rate, spacings[level], is_disturbed_motion, &found);
        if (result != 0) return result > 0 ? found : NAN;
    }
    return NAN;
}
