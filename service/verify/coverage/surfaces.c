/* Whether the triangles of two surfaces keep apart while one of them moves. */
#include <math.h>
#include <stdint.h>

#include "../../../costs/native/distance.h"

#define BLOCK 8           /* triangles that follow each other and share a box */
#define MOST_POSES 16
#define ROUNDING_M 1e-6   /* of measured distances and of placed points */

static double find_gap(const double *a, const double *b) {
    double square = 0.0;
    for (int k = 0; k < 3; k++) {
        const double d = fmax(a[k] - b[3 + k], b[k] - a[3 + k]);
        if (d > 0.0) square += d * d;
    }
    return sqrt(square);
}

static void join_boxes(const double *boxes, int64_t first, int64_t last, double *out) {
    for (int k = 0; k < 3; k++) out[k] = INFINITY, out[3 + k] = -INFINITY;
    for (int64_t i = first; i < last; i++)
        for (int k = 0; k < 3; k++) {
            out[k] = fmin(out[k], boxes[6 * i + k]);
            out[3 + k] = fmax(out[3 + k], boxes[6 * i + 3 + k]);
        }
}

/* Boxes (n_faces, 6: lower, upper corner) around triangles whose corners are at n_poses places and stray from them. */
EXPORTED void scopt_box_triangles(int64_t n_poses, int64_t n_vertices, const double *points, const double *stray,
                                  int64_t n_faces, const int64_t *faces, double *boxes) {
    for (int64_t f = 0; f < n_faces; f++) {
        double *box = boxes + 6 * f, farthest = 0.0;
        for (int k = 0; k < 3; k++) box[k] = INFINITY, box[3 + k] = -INFINITY;
        for (int c = 0; c < 3; c++) {
            const int64_t v = faces[3 * f + c];
            farthest = fmax(farthest, stray[v]);
            for (int64_t p = 0; p < n_poses; p++)
                for (int k = 0; k < 3; k++) {
                    const double x = points[3 * (p * n_vertices + v) + k];
                    box[k] = fmin(box[k], x);
                    box[3 + k] = fmax(box[3 + k], x);
                }
        }
        for (int k = 0; k < 3; k++) box[k] -= farthest, box[3 + k] += farthest;
    }
}

/* Lower bound of the distance of a moving surface from one that stays, at most limit [m]; 0 if none is shown.

   Corners of the moving triangles are within stray of the hull of their places at all poses. */
EXPORTED void scopt_separate_surfaces(int64_t n_poses, int64_t n_vertices, const double *points, const double *stray,
                                      int64_t n_faces, const int64_t *faces, const double *boxes, const double *held,
                                      int64_t n_held, const int64_t *held_faces, const double *held_boxes,
                                      double limit, double *gap) {
    double best = limit, swept[9 * MOST_POSES], still[9];
    *gap = 0.0;
    if (n_poses > MOST_POSES) return;
    for (int64_t i0 = 0; i0 < n_faces; i0 += BLOCK) {
        double block[6];
        const int64_t i1 = i0 + BLOCK < n_faces ? i0 + BLOCK : n_faces;
        join_boxes(boxes, i0, i1, block);
        for (int64_t j0 = 0; j0 < n_held; j0 += BLOCK) {
            double other[6];
            const int64_t j1 = j0 + BLOCK < n_held ? j0 + BLOCK : n_held;
            join_boxes(held_boxes, j0, j1, other);
            if (find_gap(block, other) >= best) continue;
            for (int64_t i = i0; i < i1; i++) {
                if (find_gap(boxes + 6 * i, other) >= best) continue;
                double farthest = 0.0;
                for (int c = 0; c < 3; c++) {
                    const int64_t v = faces[3 * i + c];
                    farthest = fmax(farthest, stray[v]);
                    for (int64_t p = 0; p < n_poses; p++)
                        for (int k = 0; k < 3; k++)
                            swept[3 * (c * n_poses + p) + k] = points[3 * (p * n_vertices + v) + k];
                }
                const Hull mover = {swept, 3 * n_poses, 0, 0};
                for (int64_t j = j0; j < j1; j++) {
                    if (find_gap(boxes + 6 * i, held_boxes + 6 * j) >= best) continue;
                    for (int c = 0; c < 3; c++)
                        for (int k = 0; k < 3; k++) still[3 * c + k] = held[3 * held_faces[3 * j + c] + k];
                    const Hull holder = {still, 3, 0, 0};
                    double distance, normal[3], nearest[3];
                    const Answer answer =
                        measure_hulls(&mover, &holder, best + farthest + ROUNDING_M, 0, &distance, normal, nearest);
                    if (answer == BEYOND) continue;
                    if (answer == TOUCHING || distance - farthest <= 2.0 * ROUNDING_M) return;
                    best = fmin(best, distance - farthest - ROUNDING_M);
                }
            }
        }
    }
    *gap = best;
}
