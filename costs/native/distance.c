/* Distance of two convex point sets by GJK: Gilbert, Johnson, Keerthi, IEEE J. Robotics and Automation 1988.

   The simplex is reduced by looking at all its faces, which is slower than signed volumes and has no special cases.
   What a face gives is a convex combination of points of both sets in any case: the distance is never below the true
   one by more than rounding, and a support in its direction bounds it from below.  The search ends when both agree. */
#include "distance.h"

#include <math.h>
#include <string.h>

static const double AGREES_M = 1e-10;  /* the bounds of a distance that is found */
static const double ENOUGH_M = 1e-7;   /* the same where rounding ends the search, on hulls that are nearly flat */
static const double TOUCHES_M = 1e-6;  /* below it, directions are of no use */
enum { ROUNDS = 64 };

typedef struct {
    double difference[3]; /* of a's point and b's */
    double point[3];      /* of a */
    int64_t a, b;
} Corner;

typedef struct {
    Corner corner[4];
    double share[4];
    int count;
} Simplex;

static double dot(const double a[3], const double b[3]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static void subtract(const double a[3], const double b[3], double out[3]) {
    for (int k = 0; k < 3; k++) out[k] = a[k] - b[k];
}

double find_support(const double *points, int64_t count, const double direction[3], int64_t *which) {
    const double x = direction[0], y = direction[1], z = direction[2];
    double best = -INFINITY;
    int64_t at = 0;
    for (int64_t k = 0; k < count; k++) {
        const double height = x * points[3 * k] + y * points[3 * k + 1] + z * points[3 * k + 2];
        if (height > best) {
            best = height;
            at = k;
        }
    }
    *which = at;
    return best;
}

static void place(const Hull *hull, int64_t which, double out[3]) {
    const double *p = hull->points + 3 * which, *r = hull->rotation, *t = hull->translation;
    if (!r) {
        memcpy(out, p, 3 * sizeof(double));
        return;
    }
    for (int k = 0; k < 3; k++) out[k] = r[3 * k] * p[0] + r[3 * k + 1] * p[1] + r[3 * k + 2] * p[2] + t[k];
}

static int64_t find_farthest(const Hull *hull, const double direction[3]) {
    const double *r = hull->rotation;
    int64_t which;
    if (!r) {
        find_support(hull->points, hull->count, direction, &which);
        return which;
    }
    double turned[3];
    for (int k = 0; k < 3; k++) turned[k] = r[k] * direction[0] + r[3 + k] * direction[1] + r[6 + k] * direction[2];
    find_support(hull->points, hull->count, turned, &which);
    return which;
}

/* Keep of the candidate faces the one whose point is nearest to the origin. */
static void keep_nearer(const Simplex *all, const int *corners, const double *share, int count, double *best, int *kept,
                        double *shares, int *n_kept) {
    double point[3] = {0.0, 0.0, 0.0};
    for (int k = 0; k < count; k++)
        for (int x = 0; x < 3; x++) point[x] += share[k] * all->corner[corners[k]].difference[x];
    const double square = dot(point, point);
    if (square < *best) {
        *best = square;
        *n_kept = count;
        memcpy(kept, corners, (size_t)count * sizeof(int));
        memcpy(shares, share, (size_t)count * sizeof(double));
    }
}

/* Nearest point of each edge and triangle to the origin; a tetrahedron's inside is told by the return value. */
static int reduce(Simplex *simplex, double point[3]) {
    const int n = simplex->count;
    double best = INFINITY, shares[4] = {1.0, 0.0, 0.0, 0.0};
    int kept[4] = {0, 1, 2, 3}, n_kept = 1;
    for (int i = 0; i < n; i++) {
        const double whole = 1.0;
        keep_nearer(simplex, &i, &whole, 1, &best, kept, shares, &n_kept);
    }
    for (int i = 0; i < n; i++)
        for (int j = i + 1; j < n; j++) {
            const double *p = simplex->corner[i].difference, *q = simplex->corner[j].difference;
            double edge[3];
            subtract(q, p, edge);
            const double square = dot(edge, edge), along = -dot(p, edge);
            if (!(square > 0.0) || !(along > 0.0) || !(along < square)) continue;
            const int corners[2] = {i, j};
            const double share[2] = {1.0 - along / square, along / square};
            keep_nearer(simplex, corners, share, 2, &best, kept, shares, &n_kept);
        }
    for (int i = 0; i < n; i++)
        for (int j = i + 1; j < n; j++)
            for (int k = j + 1; k < n; k++) {
                const double *p = simplex->corner[i].difference;
                double u[3], v[3];
                subtract(simplex->corner[j].difference, p, u);
                subtract(simplex->corner[k].difference, p, v);
                const double uu = dot(u, u), uv = dot(u, v), vv = dot(v, v), pu = -dot(p, u), pv = -dot(p, v);
                const double area = uu * vv - uv * uv;
                if (!(area > 1e-14 * uu * vv)) continue;
                const double second = (vv * pu - uv * pv) / area, third = (uu * pv - uv * pu) / area;
                const double first = 1.0 - second - third;
                if (!(first > 0.0) || !(second > 0.0) || !(third > 0.0)) continue;
                const int corners[3] = {i, j, k};
                const double share[3] = {first, second, third};
                keep_nearer(simplex, corners, share, 3, &best, kept, shares, &n_kept);
            }
    if (n == 4) {
        /* Inside, if every face has the origin on the side of the corner that it leaves out. */
        int inside = 1;
        for (int out = 0; out < 4 && inside; out++) {
            const double *p = simplex->corner[(out + 1) % 4].difference;
            double u[3], v[3], w[3];
            subtract(simplex->corner[(out + 2) % 4].difference, p, u);
            subtract(simplex->corner[(out + 3) % 4].difference, p, v);
            subtract(simplex->corner[out].difference, p, w);
            const double normal[3] = {u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]};
            inside = -dot(p, normal) * dot(w, normal) > 0.0;
        }
        if (inside) return 1;
    }
    Simplex less;
    less.count = n_kept;
    point[0] = point[1] = point[2] = 0.0;
    for (int k = 0; k < n_kept; k++) {
        less.corner[k] = simplex->corner[kept[k]];
        less.share[k] = shares[k];
        for (int x = 0; x < 3; x++) point[x] += shares[k] * less.corner[k].difference[x];
    }
    *simplex = less;
    return 0;
}

static void find_corner(const Hull *a, const Hull *b, const double v[3], Corner *corner) {
    const double back[3] = {-v[0], -v[1], -v[2]};
    double other[3];
    corner->a = find_farthest(a, back);
    corner->b = find_farthest(b, v);
    place(a, corner->a, corner->point);
    place(b, corner->b, other);
    subtract(corner->point, other, corner->difference);
}

Answer measure_hulls(const Hull *a, const Hull *b, double limit, int is_rough, double *distance, double normal[3],
                     double nearest[3]) {
    Simplex simplex;
    double v[3], first[3], second[3], before = INFINITY, gap = INFINITY, length = 0.0;
    place(a, 0, first);
    place(b, 0, second);
    subtract(first, second, v);
    if (!(dot(v, v) > 0.0)) v[0] = 1.0;
    simplex.count = 0;
    *distance = 0.0;
    for (int round = 0; round < ROUNDS; round++) {
        Corner corner;
        find_corner(a, b, v, &corner);
        length = sqrt(dot(v, v));
        const double below = dot(v, corner.difference) / length;
        if (!isfinite(below)) return TOUCHING;
        if (below > limit) return BEYOND;
        int is_known = 0;
        if (simplex.count) {
            gap = length - below;
            if (gap <= AGREES_M) break;
            for (int k = 0; k < simplex.count; k++)
                is_known |= simplex.corner[k].a == corner.a && simplex.corner[k].b == corner.b;
        }
        if (is_known) break;
        simplex.corner[simplex.count++] = corner;
        if (reduce(&simplex, v)) return TOUCHING;
        length = sqrt(dot(v, v));
        if (length < TOUCHES_M) return TOUCHING;
        if (is_rough && length < limit) {
            gap = 0.0;
            break;
        }
        if (!(length < before)) break;
        before = length;
    }
    if (!(gap <= ENOUGH_M)) return TOUCHING;
    *distance = length;
    memset(nearest, 0, 3 * sizeof(double));
    for (int x = 0; x < 3; x++) {
        normal[x] = -v[x] / length;
        for (int k = 0; k < simplex.count; k++) nearest[x] += simplex.share[k] * simplex.corner[k].point[x];
    }
    return APART;
}
