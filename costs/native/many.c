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
        touching[row] = measure_hulls(&a, &b, INFINITY, 0, distance + row, direction + 3 * row, nearest) != APART;
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
        answer[row] = (uint8_t)measure_hulls(&a, &b, limit[row], 0, distance + row, normal + 3 * row, nearest + 3 * row);
    }
}

/* Digest of the sources that the library was built from: build.py. */
EXPORTED const char *scopt_digest(void) { return SCOPT_DIGEST; }

typedef struct {
    double excess;
    int64_t body, other;
} Candidate;

static void insert(Candidate *list, int64_t *n, double excess, int64_t body, int64_t other) {
    int64_t k = (*n)++;
    for (; k > 0 && list[k - 1].excess > excess; k--) list[k] = list[k - 1];
    list[k] = (Candidate){excess, body, other};
}

/* Whether a pair of a robot at one pose is nearer than its margin; pairs of a margin of at most 0 are not checked.

   placed: of each joint, stride doubles apart, the rotation column by column and the translation.  Bodies have spheres
   (centre, radius), pieces boxes (low, high); margins are (bodies, pieces) and those of pairs (n_pairs, 2) of bodies.
   scratch: 12 doubles for each body, candidates: space for all pairs.  Where a distance is not known the answer is yes. */
EXPORTED int scopt_is_any_near(const double *placed, int64_t stride, int64_t n_bodies, const int64_t *joint,
                               const double *points, const int64_t *first, const double *centre, const double *radius,
                               int64_t n_pieces, const double *piece_points, const int64_t *piece_first,
                               const double *low, const double *high, const double *margin, int64_t n_pairs,
                               const int64_t *pair, const double *own, double *scratch, void *candidates) {
    double *rotation = scratch, *translation = scratch + 9 * n_bodies, normal[3], nearest[3], distance;
    Candidate *list = candidates;
    int64_t n = 0;
    for (int64_t b = 0; b < n_bodies; b++) {
        const double *from = placed + stride * joint[b];
        for (int i = 0; i < 3; i++) {
            for (int j = 0; j < 3; j++) rotation[9 * b + 3 * i + j] = from[3 * j + i];
            translation[3 * b + i] = from[9 + i];
        }
    }
    double *middle = translation + 3 * n_bodies;
    for (int64_t b = 0; b < n_bodies; b++)
        for (int i = 0; i < 3; i++) {
            const double *r = rotation + 9 * b + 3 * i, *c = centre + 3 * b;
            middle[3 * b + i] = r[0] * c[0] + r[1] * c[1] + r[2] * c[2] + translation[3 * b + i];
        }
    for (int64_t b = 0; b < n_bodies; b++)
        for (int64_t p = 0; p < n_pieces; p++) {
            const double least = margin[b * n_pieces + p], reach = radius[b] + least;
            if (!(least > 0.0)) continue;
            double square = 0.0;
            for (int k = 0; k < 3; k++) {
                const double c = middle[3 * b + k], below = low[3 * p + k] - c, above = c - high[3 * p + k];
                const double gap = below > above ? below : above;
                square += gap > 0.0 ? gap * gap : 0.0;
            }
            if (!(square >= reach * reach)) insert(list, &n, sqrt(square) - reach, b, p);
        }
    for (int64_t k = 0; k < n_pairs; k++) {
        const double *a = middle + 3 * pair[2 * k], *b = middle + 3 * pair[2 * k + 1];
        const double x = a[0] - b[0], y = a[1] - b[1], z = a[2] - b[2], square = x * x + y * y + z * z;
        const double reach = radius[pair[2 * k]] + radius[pair[2 * k + 1]] + own[k];
        if (own[k] > 0.0 && !(square >= reach * reach)) insert(list, &n, sqrt(square) - reach, -1, k);
    }
    for (int64_t k = 0; k < n; k++) {
        const int is_own = list[k].body < 0;
        const int64_t o = list[k].other, b = is_own ? pair[2 * o] : list[k].body, other = is_own ? pair[2 * o + 1] : o;
        const Hull body = {points + 3 * first[b], first[b + 1] - first[b], rotation + 9 * b, translation + 3 * b};
        Hull held = {piece_points + 3 * piece_first[other], 0, 0, 0};
        if (is_own)
            held = (Hull){points + 3 * first[other], first[other + 1] - first[other], rotation + 9 * other,
                          translation + 3 * other};
        else
            held.count = piece_first[other + 1] - piece_first[other];
        const double least = is_own ? own[o] : margin[b * n_pieces + o];
        if (measure_hulls(&body, &held, least, 1, &distance, normal, nearest) != BEYOND && !(distance > least)) return 1;
    }
    return 0;
}

/* Vertices (n, 3) that reach the lowest height along a direction, within a band: their height and mean. */
static double find_lowest(const double *points, int64_t n, const double *direction, double band, double mean[3]) {
    const double back[3] = {-direction[0], -direction[1], -direction[2]};
    int64_t which, count = 0;
    const double lowest = -find_support(points, n, back, &which);
    mean[0] = mean[1] = mean[2] = 0.0;
    for (int64_t k = 0; k < n; k++) {
        const double *p = points + 3 * k;
        if (!(direction[0] * p[0] + direction[1] * p[1] + direction[2] * p[2] < lowest + band)) continue;
        for (int x = 0; x < 3; x++) mean[x] += p[x];
        count++;
    }
    for (int x = 0; x < 3; x++) mean[x] /= (double)count;
    return lowest;
}

/* Weight of the second pose in the gradient of swept hulls, and the witness at both poses: share_gradient in sweep.py.

   first and second are (n, width, 3). */
EXPORTED void scopt_share_gradient(int64_t n, int64_t width, const double *first, const double *second,
                                   const double *normal, const double *witness, double band, double *share,
                                   double *at_first, double *at_second) {
    for (int64_t row = 0; row < n; row++) {
        const double *w = witness + 3 * row, *ends[2] = {first, second};
        double low[2], far[2], *points[2] = {at_first + 3 * row, at_second + 3 * row};
        for (int k = 0; k < 2; k++) {
            low[k] = find_lowest(ends[k] + 3 * width * row, width, normal + 3 * row, band, points[k]);
            const double x = w[0] - points[k][0], y = w[1] - points[k][1], z = w[2] - points[k][2];
            far[k] = sqrt(x * x + y * y + z * z);
        }
        const double total = far[0] + far[1], apart = 10.0 * band;
        double s = total < band ? 0.5 : far[0] / total;
        if (low[1] - low[0] > apart) s = 0.0;
        else if (low[0] - low[1] > apart) s = 1.0;
        share[row] = s;
        for (int x = 0; x < 3; x++) {
            const double offset = w[x] - (1.0 - s) * points[0][x] - s * points[1][x];
            points[0][x] += offset;
            points[1][x] += offset;
        }
    }
}

/* Intervals and pairs of bodies in which the mover, swept in the other's frame, comes near that one's box.

   first, second (n): waypoints of each interval.  rotation, position: of all joints at all waypoints.  world (., bodies,
   width, 3): vertices.  Bodies have a joint, a box (low, high) and a sphere (centre, radius) in its frame.  pair
   (n_pairs, 2): the one that is still, and the mover; reach: how near is near.  Returns how many there are; interval,
   number and the mover's vertices at both waypoints, in the other's frame, are written row by row. */
EXPORTED int64_t scopt_sweep_pairs(int64_t n, const int64_t *first, const int64_t *second, int64_t joints,
                                   const double *rotation, const double *position, int64_t bodies, int64_t width,
                                   const double *world, const int64_t *joint, const double *low, const double *high,
                                   const double *centre, const double *radius, int64_t n_pairs, const int64_t *pair,
                                   const double *reach, int64_t *interval, int64_t *number, double *at_first,
                                   double *at_second) {
    int64_t found = 0;
    for (int64_t i = 0; i < n; i++)
        for (int64_t k = 0; k < n_pairs; k++) {
            const int64_t still = pair[2 * k], moving = pair[2 * k + 1], poses[2] = {first[i], second[i]};
            const double *frame[2], *origin[2], *box[2] = {low + 3 * still, high + 3 * still};
            double at[2][3], square = 0.0;
            for (int end = 0; end < 2; end++) {
                const int64_t held = poses[end] * joints + joint[still], moved = poses[end] * joints + joint[moving];
                const double *R = rotation + 9 * moved, *t = position + 3 * moved, *c = centre + 3 * moving;
                double away[3];
                frame[end] = rotation + 9 * held;
                origin[end] = position + 3 * held;
                for (int x = 0; x < 3; x++)
                    away[x] = R[3 * x] * c[0] + R[3 * x + 1] * c[1] + R[3 * x + 2] * c[2] + t[x] - origin[end][x];
                for (int x = 0; x < 3; x++)
                    at[end][x] = frame[end][x] * away[0] + frame[end][3 + x] * away[1] + frame[end][6 + x] * away[2];
            }
            for (int x = 0; x < 3; x++) {
                const double least = at[0][x] < at[1][x] ? at[0][x] : at[1][x], most = at[0][x] + at[1][x] - least;
                const double above = least - box[1][x], below = box[0][x] - most, gap = above > below ? above : below;
                square += gap > 0.0 ? gap * gap : 0.0;
            }
            const double within = radius[moving] + reach[k] > 0.0 ? radius[moving] + reach[k] : 0.0;
            if (square > within * within * (1.0 + 1e-12)) continue;
            double least[3] = {INFINITY, INFINITY, INFINITY}, most[3] = {-INFINITY, -INFINITY, -INFINITY};
            for (int end = 0; end < 2; end++) {
                const double *from = world + 3 * width * (poses[end] * bodies + moving), *R = frame[end];
                double *to = (end ? at_second : at_first) + 3 * width * found;
                for (int64_t v = 0; v < width; v++, from += 3, to += 3) {
                    const double x = from[0] - origin[end][0], y = from[1] - origin[end][1], z = from[2] - origin[end][2];
                    for (int axis = 0; axis < 3; axis++) {
                        const double value = x * R[axis] + y * R[3 + axis] + z * R[6 + axis];
                        to[axis] = value;
                        if (value < least[axis]) least[axis] = value;
                        if (value > most[axis]) most[axis] = value;
                    }
                }
            }
            int is_near = 1;
            for (int x = 0; x < 3; x++) is_near &= least[x] - reach[k] <= box[1][x] && box[0][x] <= most[x] + reach[k];
            if (!is_near) continue;
            interval[found] = i;
            number[found++] = k;
        }
    return found;
}
