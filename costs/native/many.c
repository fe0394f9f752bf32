/* Distances of many pairs in one call. */
#include "distance.h"

#include <math.h>
#include <string.h>

/* Pairs of the verifier: hulls (S) as points (sum of V, 3) from first[s] to first[s + 1]; the mover of each row is
   placed in its holder's frame.  Rows whose answer is not known are told by touching. */
EXPORTED void scopt_measure_pairs(int64_t n, const double *points, const int64_t *first, const int64_t *mover,
                         const int64_t *holder, const double *rotation, const double *translation, double *distance,
                         double *direction, uint8_t *touching) {
    for (int64_t row = 0; row < n; row++) {
        const int64_t m = mover[row], h = holder[row];
        const Hull a = {points + 3 * first[m], first[m + 1] - first[m], rotation + 9 * row, translation + 3 * row};
        const Hull b = {points + 3 * first[h], first[h + 1] - first[h], 0, 0};
        double nearest[3];
        touching[row] = measure_hulls(&a, &b, INFINITY, distance + row, direction + 3 * row, nearest) != APART;
    }
}

/* Swept bodies: row r is the hull of body's points at two poses, first and second (., W, 3), row pose[r] of them,
   against other's points.  limit bounds what is of interest.  answer: see Answer. */
EXPORTED void scopt_measure_swept(int64_t n, int64_t width, const double *first, const double *second, const int64_t *pose,
                         const int64_t *count, const double *points, const int64_t *start, const int64_t *other,
                         const double *limit, double *scratch, double *distance, double *normal, double *nearest,
                         uint8_t *answer) {
    int64_t written = -1;
    for (int64_t row = 0; row < n; row++) {
        const int64_t c = count[row], o = other[row];
        if (pose[row] != written) {
            written = pose[row];
            memcpy(scratch, first + 3 * width * written, (size_t)(3 * c) * sizeof(double));
            memcpy(scratch + 3 * c, second + 3 * width * written, (size_t)(3 * c) * sizeof(double));
        }
        const Hull a = {scratch, 2 * c, 0, 0};
        const Hull b = {points + 3 * start[o], start[o + 1] - start[o], 0, 0};
        answer[row] = (uint8_t)measure_hulls(&a, &b, limit[row], distance + row, normal + 3 * row, nearest + 3 * row);
    }
}

/* Digest of the sources that the library was built from: build.py. */
EXPORTED const char *scopt_digest(void) { return SCOPT_DIGEST; }
