/* What the proof of an interval computes per pair: poses, how far a mover leaves its chords, and separations.

   The same as PairPoses does with numpy: see pair_poses.py and joint_chain.py for what the arrays mean. */
#include <math.h>
#include <stdint.h>

#include "../../../costs/native/distance.h"

/* Poses (n, 3 of first, last, middle) of movers in their holders' frames. */
EXPORTED void scopt_place_pairs(int64_t n, int64_t joints, const double *rotation, const double *translation, const int64_t *pose,
                       const int64_t *held, const int64_t *moved, double *turned, double *shifted) {
    for (int64_t row = 0; row < 3 * n; row++) {
        const int64_t h = pose[row] * joints + held[row / 3], m = pose[row] * joints + moved[row / 3];
        const double *a = rotation + 9 * h, *b = rotation + 9 * m, *s = translation + 3 * h, *t = translation + 3 * m;
        for (int i = 0; i < 3; i++) {
            for (int j = 0; j < 3; j++)
                turned[9 * row + 3 * i + j] = a[i] * b[j] + a[3 + i] * b[3 + j] + a[6 + i] * b[6 + j];
            shifted[3 * row + i] = a[i] * (t[0] - s[0]) + a[3 + i] * (t[1] - s[1]) + a[6 + i] * (t[2] - s[2]);
        }
    }
}

/* How far the movers leave their chords [m]: deviation with the local reach, and what exported samples add.

   scratch: two rows of a chain's width. */
EXPORTED void scopt_bound_deviation(int64_t n, int64_t joints, const double *rotation, const double *translation,
                          const int64_t *middle, const int64_t *joint, const double *centre, const double *radius,
                          int64_t chains, int64_t width, const int64_t *chain, const int64_t *coordinates, const int64_t *chain_joints,
                          const uint8_t *is_revolute, const double *reach, const uint8_t *base_rotations,
                          const double *ratio, const int64_t *rate, int64_t columns, const double *length,
                          const double *speed, const double *bend, const double *step, const double *step_speed,
                          const double *step_bend, double rounding, double *scratch, double *bound) {
    double *own = scratch, *local = scratch + width;
    for (int64_t row = 0; row < n; row++) {
        if (chain[row] < 0 || chain[row] >= chains) { /* no bound is known */
            bound[row] = INFINITY;
            continue;
        }
        const int64_t c = chain[row] * width, u = rate[row], r = u * columns, pose = middle[row] * joints;
        const double *R = rotation + 9 * (pose + joint[row]), *t = translation + 3 * (pose + joint[row]);
        const double *p = centre + 3 * row, h = length[u];
        double world[3];
        for (int k = 0; k < 3; k++) world[k] = R[3 * k] * p[0] + R[3 * k + 1] * p[1] + R[3 * k + 2] * p[2] + t[k];
        double distal = 0.0;
        for (int64_t k = width - 1; k >= 0; k--) {
            own[k] = speed[r + coordinates[c + k]] * ratio[c + k];
            local[k] = reach[c + k];
            if (is_revolute[c + k]) {
                const double *o = translation + 3 * (pose + chain_joints[c + k]);
                const double x = o[0] - world[0], y = o[1] - world[1], z = o[2] - world[2];
                const double near = sqrt(x * x + y * y + z * z) + radius[row] + 0.5 * h * distal;
                if (!(near >= local[k])) local[k] = near;
            }
            distal += own[k] * reach[c + k];
        }
        double curvature = 0.0, proximal = 0.0, line = 0.0, turn = 0.0, lever = 0.0;
        const double d = step[u];
        for (int64_t k = 0; k < width; k++) {
            const int64_t q = r + coordinates[c + k];
            const double turning = is_revolute[c + k] ? own[k] : 0.0;
            curvature += local[k] * (own[k] * (2.0 * proximal + turning) + bend[q] * ratio[c + k]);
            proximal += turning;
            line += reach[c + k] * (d * d / 8.0 * step_bend[q] * ratio[c + k] + rounding * ratio[c + k]);
            if (base_rotations[c + k]) {
                turn += d * step_speed[q] * ratio[c + k];
                if (reach[c + k] > lever) lever = reach[c + k];
            }
        }
        bound[row] = h * h / 8.0 * curvature + (d > 0.0 ? line + turn * turn / 4.0 * lever : 0.0);
    }
}

/* Lower bound of the distance of each mover's two end poses from its holder along a direction, by all vertices [m]. */
EXPORTED void scopt_separate(int64_t n, const int64_t *rows, const double *points, const int64_t *first, const int64_t *mover,
                    const int64_t *holder, const double *rotation, const double *translation, const double *direction,
                    double *separation) {
    for (int64_t k = 0; k < n; k++) {
        const int64_t row = rows[k], m = mover[row], h = holder[row];
        const double *d = direction + 3 * k, back[3] = {-d[0], -d[1], -d[2]};
        double farthest = -INFINITY;
        int64_t which;
        int is_known = 1;
        for (int64_t pose = 3 * row; pose < 3 * row + 2; pose++) {
            const double *R = rotation + 9 * pose, *t = translation + 3 * pose;
            double turned[3];
            for (int x = 0; x < 3; x++) turned[x] = d[0] * R[x] + d[1] * R[3 + x] + d[2] * R[6 + x];
            const double reach = find_support(points + 3 * first[m], first[m + 1] - first[m], turned, &which) +
                                 t[0] * d[0] + t[1] * d[1] + t[2] * d[2];
            is_known &= isfinite(reach);
            if (reach > farthest) farthest = reach;
        }
        const double value = -find_support(points + 3 * first[h], first[h + 1] - first[h], back, &which) - farthest;
        separation[k] = is_known && isfinite(value) ? value : -INFINITY;
    }
}
