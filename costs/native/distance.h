/* Distances of convex point sets, shared by the functions of this folder. */
#ifndef SCOPT_DISTANCE_H
#define SCOPT_DISTANCE_H

#include <stdint.h>

#define EXPORTED __attribute__((visibility("default")))

/* A convex set: the hull of points (n, 3), at rotation (3, 3, row by row) and translation (3); NULL: where they are. */
typedef struct {
    const double *points;
    int64_t count;
    const double *rotation;
    const double *translation;
} Hull;

typedef enum { TOUCHING, APART, BEYOND } Answer;

/* Signed distance of two hulls that are apart: distance [m], the unit normal from a to b, and a's nearest point.

   APART: the distance is right within 0.1 micrometres; if is_rough, any that is shown to be below limit.
   BEYOND: it is larger than limit, and nothing else is known.
   TOUCHING (distance 0): the hulls meet, are nearer than a micrometre, or rounding keeps the search from ending. */
Answer measure_hulls(const Hull *a, const Hull *b, double limit, int is_rough, double *distance, double normal[3],
                     double nearest[3]);

/* Largest value of direction . p over the points (n, 3), and which point has it. */
double find_support(const double *points, int64_t count, const double direction[3], int64_t *which);

#endif
