/* Copyright 2026 sphere_nmpc contributors
   SPDX-License-Identifier: Apache-2.0 */
/* Shortest ways to a goal over a lattice of nodes, by Dijkstra's algorithm. */

#include <math.h>

#define WAY_NEIGHBOURS 16

static const int way_rows[WAY_NEIGHBOURS] = {0, 0, 1, -1, 1, 1, -1, -1, 1, 1, -1, -1, 2, 2, -2, -2};
static const int way_columns[WAY_NEIGHBOURS] = {1, -1, 0, 0, 1, -1, 1, -1, 2, -2, 2, -2, 1, -1, 1, -1};

/* Move the node at a place of the heap up until its parent is nearer to the goal. */
static void way_rise(int *heap, int *place, const float *length, int at)
{
    int node = heap[at];
    while (at > 0) {
        int above = (at - 1) / 2;
        if (length[heap[above]] <= length[node]) break;
        heap[at] = heap[above];
        place[heap[at]] = at;
        at = above;
    }
    heap[at] = node;
    place[node] = at;
}

static void way_sink(int *heap, int *place, const float *length, int size)
{
    int node = heap[0], at = 0;
    for (;;) {
        int below = 2 * at + 1;
        if (below >= size) break;
        if (below + 1 < size && length[heap[below + 1]] < length[heap[below]]) ++below;
        if (length[node] <= length[heap[below]]) break;
        heap[at] = heap[below];
        place[heap[at]] = at;
        at = below;
    }
    heap[at] = node;
    place[node] = at;
}

/* Find the lengths of the ways from all nodes to the goal, and the next node on each.

   `cost` is that of a unit of the way at each node, infinite at one that must not be passed.
   `length` has to be infinite everywhere, `next` and `place` -1; `heap` is memory for all nodes. */
void hold_way(int64_t rows, int64_t columns, int64_t goal, const float *cost, float *length,
              int32_t *next, int32_t *heap, int32_t *place)
{
    int size = 1;
    length[goal] = 0.0f;
    next[goal] = (int)goal;
    heap[0] = (int)goal;
    place[goal] = 0;
    while (size > 0) {
        int node = heap[0], row = node / (int)columns, column = node % (int)columns;
        place[node] = -2;
        if (--size > 0) {
            heap[0] = heap[size];
            way_sink(heap, place, length, size);
        }
        for (int k = 0; k < WAY_NEIGHBOURS; ++k) {
            int i = row + way_rows[k], j = column + way_columns[k];
            if (i < 0 || j < 0 || i >= rows || j >= columns) continue;
            int other = i * (int)columns + j;
            if (place[other] == -2 || !(cost[other] < INFINITY)) continue;
            float unit = k < 4 ? 1.0f : k < 8 ? 1.41421356f : 2.23606798f;
            float found = length[node] + 0.5f * unit * (cost[node] + cost[other]);
            if (found < length[other]) {
                if (place[other] < 0) {
                    place[other] = size;
                    heap[size++] = other;
                }
                length[other] = found;
                next[other] = node;
                way_rise(heap, place, length, place[other]);
            }
        }
    }
}
