/* Eq. (1) by Taylor series, in the precision REAL. Contacts c = 0 ... N: above grain 0, between grains, below grain N-1.

Every step expands all displacements in time to order p. A contact that is shut contributes the series of K o^delta - F,
by the recurrence of a power; one that is open -F. Its force is not analytic where it opens, which the last coefficients
show: steps shrink towards such a moment, until what the contact still gives is below `tol`, and grow away from one. */

#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <tgmath.h>

#define ORDERS 40
#define SCAN 8

typedef struct {
  int kind; /* 0 none, 1 sum of sines, 2 spline */
  int grain; /* where: -1 the top wall, 0 grain 0 (both are put there), n + 1 pushes grain n */
  int sines;
  const REAL *amplitude, *omega;
  REAL end; /* of the sines, 0 afterwards */
  int knots;
  const REAL *times, *pieces; /* pieces: (knots - 1, 4), ascending powers */
} Drive;

/* Time up to which it stays the same analytic function. */
static REAL kink(const Drive *d, REAL t, REAL end) {
  REAL next = end;
  if (d->kind == 1 && t < d->end) next = d->end;
  if (d->kind == 2) {
    int i = 0;
    while (i < d->knots - 2 && d->times[i + 1] <= t) i++;
    next = i < d->knots - 2 ? d->times[i + 1] : end;
  }
  return next < end ? next : end;
}

static void drive_series(const Drive *d, REAL t, int p, REAL *a) {
  memset(a, 0, sizeof(REAL) * (p + 1));
  if (d->kind == 1) {
    for (int i = 0; i < d->sines && t < d->end; i++) {
      REAL s = d->amplitude[i] * sin(d->omega[i] * t), c = d->amplitude[i] * cos(d->omega[i] * t), power = 1;
      for (int k = 0; k <= p; k++) {
        a[k] += power * ((k & 1) ? c : s) * ((k & 2) ? -1 : 1);
        power *= d->omega[i] / (k + 1);
      }
    }
  } else {
    int i = 0;
    while (i < d->knots - 2 && d->times[i + 1] <= t) i++;
    const REAL *q = d->pieces + 4 * i;
    REAL s = t - d->times[i];
    a[0] = q[0] + s * (q[1] + s * (q[2] + s * q[3]));
    a[1] = q[1] + s * (2 * q[2] + 3 * s * q[3]);
    a[2] = q[2] + 3 * s * q[3];
    a[3] = q[3];
  }
}

static REAL value(const REAL *a, int p, REAL t) {
  REAL y = a[p];
  for (int k = p - 1; k >= 0; k--) y = y * t + a[k];
  return y;
}

static REAL slope(const REAL *a, int p, REAL t) {
  REAL y = p * a[p];
  for (int k = p - 1; k >= 1; k--) y = y * t + k * a[k];
  return y;
}

/* First time in (0, h] at which o passes from not above 0 to above 0 (sign = 1), or below (sign = -1); or -1.
   After it, until `*beyond`, it stays there. */
static REAL crossing(const REAL *a, int p, REAL h, int sign, int from_start, REAL *beyond) {
  REAL before = 0, at = 0;
  REAL slope_before = sign * a[1];
  for (int i = 1; i <= SCAN; i++) {
    at = h * i / SCAN;
    REAL y = sign * value(a, p, at), dy = sign * slope(a, p, at), found = -1;
    if (y > 0) found = at;
    else if (slope_before > 0 && dy < 0) { /* a maximum between */
      REAL left = before, right = at;
      for (int b = 0; b < 40; b++) {
        REAL mid = (left + right) / 2;
        if (sign * slope(a, p, mid) > 0) left = mid; else right = mid;
      }
      if (sign * value(a, p, left) > 0) found = left;
    }
    if (found >= 0) {
      *beyond = found;
      REAL left = before, right = found;
      if (i == 1 && from_start) return 0;
      for (int b = 0; b < 70; b++) {
        REAL mid = (left + right) / 2;
        if (sign * value(a, p, mid) > 0) right = mid; else left = mid;
      }
      return right;
    }
    before = at;
    slope_before = dy;
  }
  return -1;
}

/* Returns 0, 1 if `most` contact-steps were too few, 2 if a step became too short, 3 if a series has no numbers. */
int integrate(int N, const REAL *delta_, const REAL *K, const REAL *F, const REAL *eps, const REAL *mobility,
              const REAL *viscosity, const REAL *drag, int kind, int grain, int sines, const REAL *sine, int knots, const REAL *knot_times, const REAL *pieces, const REAL *start, int T,
              const REAL *times, double tol_, int p, double most, double *out, double *peak, double *stats) {
  const REAL delta = *delta_, tol = tol_;
  const int whole = delta == 1 || delta == 2 || delta == 3;
  int damped = 0; /* K (1 + A d/dt) o^delta - F in a shut contact, and - gamma v */
  for (int c = 0; c <= N; c++) damped |= viscosity[c] > 0 || (c < N && drag[c] > 0);
  Drive drive = {kind, grain, sines, sine, sine + sines, sine[2 * sines], knots, knot_times, pieces};
  REAL *X = calloc((size_t)(p + 1) * N, sizeof(REAL)), *O = calloc((size_t)(p + 1) * (N + 1), sizeof(REAL));
  REAL *G = calloc((size_t)(p + 1) * (N + 1), sizeof(REAL)), *Q = calloc((size_t)(p + 1) * (N + 1), sizeof(REAL));
  REAL *push = calloc(N + 1, sizeof(REAL)); /* K o^delta at the begin of a step; G[0] + F loses it if it is below one ulp of F */
  REAL *root = calloc(N + 1, sizeof(REAL)), *x = malloc(sizeof(REAL) * N), *v = malloc(sizeof(REAL) * N);
  REAL *next_x = malloc(sizeof(REAL) * N), *next_v = malloc(sizeof(REAL) * N);
  char *shut = calloc(N + 1, 1);
  REAL driven[ORDERS], a[ORDERS];
  int lo = N, hi = 0, result = 0, sample = 0;
  double work = 0, steps = 0, events = 0;
  memcpy(x, start, sizeof(REAL) * N);
  memcpy(v, start + N, sizeof(REAL) * N);
  REAL wall[ORDERS];
  memset(wall, 0, sizeof wall);
  if (kind) {
    drive_series(&drive, 0, p, driven);
    if (grain == 0) {
      x[0] = driven[0];
      v[0] = driven[1];
    }
    if (grain < 0) memcpy(wall, driven, sizeof(REAL) * (p + 1));
    lo = grain > 0 ? grain - 1 : 0;
    hi = lo + 1;
  }
#define ABOVE(k, c) ((c) > first ? X[(size_t)(k) * N + (c) - 1] : (c) == 0 ? wall[k] : 0)
  for (int n = 0; n < N; n++)
    if (x[n] != 0 || v[n] != 0) {
      if (n < lo) lo = n;
      if (n + 1 > hi) hi = n + 1;
    }
  if (hi <= lo) { lo = 0; hi = 1; }
  for (int c = 0; c <= N; c++) {
    REAL o = eps[c] + (c ? x[c - 1] : wall[0]) - (c < N ? x[c] : 0);
    shut[c] = K[c] > 0 && o > 0;
    root[c] = 0;
  }
  REAL t = 0, end = times[T - 1], X_peak = 1, V_peak = 1e-6, ulp = 1;
  while (1 + ulp / 2 > 1) ulp /= 2;
  for (int n = lo; n < hi; n++) {
    if (fabs(x[n]) > X_peak) X_peak = fabs(x[n]);
    if (fabs(v[n]) > V_peak) V_peak = fabs(v[n]);
  }
  peak[0] = peak[1] = 0;
  for (int n = 0; n < N; n++) {
    peak[0] = fmax(peak[0], (double)fabs(x[n]));
    peak[1] = fmax(peak[1], (double)fabs(v[n]));
  }
  REAL knot_end = end;
  while (sample < T) {
    int pad = (damped ? p : p / 2) + 2, first = lo - pad > 0 ? lo - pad : 0, last = hi + pad < N ? hi + pad : N; /* grains */
    if (kind) knot_end = kink(&drive, t, end);
    for (int n = first; n < last; n++) {
      X[n] = x[n];
      X[N + n] = v[n];
    }
    if (kind) {
      drive_series(&drive, t, p, driven);
      if (grain == 0)
        for (int k = 0; k <= p; k++) X[(size_t)k * N] = driven[k];
      if (grain < 0) memcpy(wall, driven, sizeof(REAL) * (p + 1));
    }
    for (int c = first; c <= last; c++) { /* shut ones that give nothing more */
      REAL o = eps[c] + ABOVE(0, c) - (c < last ? X[c] : 0);
      REAL rate = ABOVE(1, c) - (c < last ? X[N + c] : 0);
      O[c] = o;
      if (!shut[c] || rate >= 0) continue;
      REAL mob = fmax(c > 0 ? mobility[c - 1] : 0, c < N ? mobility[c] : 0);
      if (o <= 0 || K[c] * pow(o, delta) * (o / -rate + viscosity[c]) * mob <= tol * V_peak) {
        shut[c] = 0;
        root[c] = t;
        events++;
      }
    }
    for (int k = 0; k <= p - 2 + damped; k++) {
      REAL *g = G + (size_t)k * (N + 1), *o = O + (size_t)k * (N + 1), *above = X + (size_t)k * N;
      if (k)
        for (int c = first; c <= last; c++) o[c] = ABOVE(k, c) - (c < last ? above[c] : 0);
      if (k == 0) {
        for (int c = first; c <= last; c++) {
          REAL r = ABOVE(0, c) - (c < last ? X[c] : 0);
          if (!shut[c]) g[c] = -F[c];
          else if (delta == 1) g[c] = K[c] * r;
          else if (eps[c] > 0 && r > -eps[c] / 2) {
            g[c] = F[c] * expm1(delta * log1p(r / eps[c]));
            push[c] = F[c] + g[c];
          } else {
            push[c] = K[c] * pow(o[c], delta);
            g[c] = push[c] - F[c];
          }
        }
      } else if (delta == 1) {
        for (int c = first; c <= last; c++) g[c] = shut[c] ? K[c] * o[c] : 0;
      } else if (delta == 2 || delta == 3) {
        REAL *q = Q + (size_t)k * (N + 1);
        if (k == 1) for (int c = first; c <= last; c++) Q[c] = O[c] * O[c];
        for (int c = first; c <= last; c++) q[c] = 0;
        for (int j = 0; j <= k; j++) {
          REAL *left = O + (size_t)j * (N + 1), *right = O + (size_t)(k - j) * (N + 1);
          for (int c = first; c <= last; c++) q[c] += left[c] * right[c];
        }
        for (int c = first; c <= last; c++) g[c] = 0;
        if (delta == 2) for (int c = first; c <= last; c++) g[c] = q[c];
        else
          for (int j = 0; j <= k; j++) {
            REAL *left = O + (size_t)j * (N + 1), *right = Q + (size_t)(k - j) * (N + 1);
            for (int c = first; c <= last; c++) g[c] += left[c] * right[c];
          }
        for (int c = first; c <= last; c++) g[c] = shut[c] ? K[c] * g[c] : 0;
      } else {
        for (int c = first; c <= last; c++) g[c] = 0;
        for (int j = 1; j <= k; j++) {
          REAL *left = O + (size_t)j * (N + 1), *right = G + (size_t)(k - j) * (N + 1), by = delta * j - (k - j);
          if (j < k) for (int c = first; c <= last; c++) g[c] += by * left[c] * right[c];
          else for (int c = first; c <= last; c++) g[c] += by * left[c] * push[c];
        }
        for (int c = first; c <= last; c++) g[c] = shut[c] ? g[c] / (k * O[c]) : 0;
      }
      if (damped) { /* x of order k + 1 needs the rates of forces of order k - 1, which are those of order k */
        if (k == 0) continue;
        REAL *next = X + (size_t)(k + 1) * N, *now = X + (size_t)k * N, *before = G + (size_t)(k - 1) * (N + 1);
        for (int n = first; n < last; n++) {
          REAL pull = before[n] - before[n + 1] + k * (viscosity[n] * g[n] - viscosity[n + 1] * g[n + 1]);
          next[n] = pull * mobility[n] / (k * (k + 1));
          if (mobility[n] > 0) next[n] -= drag[n] * now[n] / (k + 1);
        }
        if (kind && grain == 0) next[0] = driven[k + 1];
        if (kind && grain > 0) next[grain - 1] += driven[k - 1] * mobility[grain - 1] / (k * (k + 1));
        continue;
      }
      REAL *next = X + (size_t)(k + 2) * N;
      for (int n = first; n < last; n++) next[n] = (g[n] - g[n + 1]) * mobility[n] / ((k + 1) * (k + 2));
      if (kind && grain == 0) next[0] = driven[k + 2];
      if (kind && grain > 0) next[grain - 1] += driven[k] * mobility[grain - 1] / ((k + 1) * (k + 2));
    }
    for (int k = p - 1; k <= p; k++)
      for (int c = first; c <= last; c++)
        O[(size_t)k * (N + 1) + c] = ABOVE(k, c) - (c < last ? X[(size_t)k * N + c] : 0);
    work += last - first + 1;
    steps++;
    REAL h = end - t;
    if (kind && knot_end - t < h) h = knot_end - t;
    for (int k = p - 2; k <= p; k++) {
      REAL most_x = grain < 0 ? fabs(wall[k]) : 0; /* also while it moves alone */
      for (int n = first; n < last; n++) {
        REAL y = fabs(X[(size_t)k * N + n]);
        if (!(y < INFINITY)) { result = 3; goto done; }
        if (y > most_x) most_x = y;
      }
      if (most_x > 0) {
        h = fmin(h, pow(tol * X_peak / most_x, (REAL)1 / k));
        h = fmin(h, pow(tol * V_peak / (k * most_x), (REAL)1 / (k - 1)));
      }
    }
    int flip = -1;
    for (int c = first; c <= last; c++) {
      if (!(K[c] > 0) || (shut[c] && !whole)) continue;
      REAL spread = 0, power = h;
      for (int k = 1; k <= p; k++) {
        spread += fabs(O[(size_t)k * (N + 1) + c]) * power;
        power *= h;
      }
      if (spread == 0 || (shut[c] ? O[c] - spread >= 0 : O[c] + spread <= 0)) continue;
      for (int k = 0; k <= p; k++) a[k] = O[(size_t)k * (N + 1) + c];
      if (shut[c]) {
        REAL beyond, when = crossing(a, p, h, -1, 0, &beyond);
        if (when >= 0 && when < h) { h = when; flip = c; }
        continue;
      }
      REAL beyond, when = crossing(a, p, h, 1, O[c] >= 0, &beyond);
      if (when < 0) { root[c] = INFINITY; continue; }
      if (!(O[c] >= 0 && root[c] <= t)) root[c] = t + when;
      REAL mob = fmax(c > 0 ? mobility[c - 1] : 0, c < N ? mobility[c] : 0), good = when, bad = -1;
      /* less is round-off of displacements, that would leave an overlap of 0, whose power has no series; it matters
         where contacts are viscous and delta is hardly above 1 */
      const REAL least = 8 * ulp * X_peak;
      for (int i = 0; i <= 2 * SCAN; i++) { /* a touch may be shorter than what the scan resolves after it */
        REAL at = i <= SCAN ? when + (beyond - when) * i / SCAN : beyond + (h - beyond) * (i - SCAN) / SCAN, o = value(a, p, at);
        if (o > least && K[c] * pow(o, delta) * (t + at - root[c] + viscosity[c]) * mob > tol * V_peak) { bad = at; break; }
        good = at;
      }
      if (bad < 0) continue;
      if (bad > when)
        for (int b = 0; b < 60; b++) {
          REAL mid = (good + bad) / 2, o = value(a, p, mid);
          if (o > least && K[c] * pow(o, delta) * (t + mid - root[c] + viscosity[c]) * mob > tol * V_peak) bad = mid; else good = mid;
        }
      if (bad < h) { h = bad; flip = c; }
    }
    if (kind && flip < 0 && t + h >= knot_end) h = knot_end - t;
    while (sample < T && (times[sample] <= t + h || (t + h >= end))) {
      REAL s = times[sample] - t;
      for (int n = 0; n < N; n++) {
        REAL y = 0, dy = 0;
        if (n >= first && n < last) {
          for (int k = p; k >= 1; k--) {
            y = y * s + X[(size_t)k * N + n];
            dy = dy * s + k * X[(size_t)k * N + n];
          }
          y = y * s + X[n];
        }
        out[((size_t)2 * sample) * N + n] = y;
        out[((size_t)2 * sample + 1) * N + n] = dy;
      }
      sample++;
    }
    for (int i = 1; i <= 4; i++) {
      REAL s = h * i / 4;
      for (int n = first; n < last; n++) next_x[n] = next_v[n] = 0;
      for (int k = p; k >= 1; k--) {
        REAL *row = X + (size_t)k * N;
        for (int n = first; n < last; n++) {
          next_x[n] = next_x[n] * s + row[n];
          next_v[n] = next_v[n] * s + k * row[n];
        }
      }
      for (int n = first; n < last; n++) {
        next_x[n] = next_x[n] * s + X[n];
        if (fabs(next_x[n]) > X_peak) X_peak = fabs(next_x[n]);
        if (fabs(next_v[n]) > V_peak) V_peak = fabs(next_v[n]);
        peak[0] = fmax(peak[0], (double)fabs(next_x[n]));
        peak[1] = fmax(peak[1], (double)fabs(next_v[n]));
      }
    }
    for (int n = first; n < last; n++) {
      x[n] = next_x[n];
      v[n] = next_v[n];
    }
    if (flip >= 0) {
      shut[flip] = !shut[flip];
      root[flip] = t + h;
      events++;
    }
    t = kind && flip < 0 && t + h >= knot_end ? knot_end : t + h;
    const REAL cut = tol * (REAL)1e-6;
    while (first < lo && fabs(x[first]) <= cut * X_peak && fabs(v[first]) <= cut * V_peak) x[first] = v[first] = 0, first++;
    while (last > hi && fabs(x[last - 1]) <= cut * X_peak && fabs(v[last - 1]) <= cut * V_peak) last--, x[last] = v[last] = 0;
    lo = first < lo ? first : lo;
    hi = last > hi ? last : hi;
    if (work * p * p > most) { result = 1; break; }
    if (steps > 1e7) { result = 2; break; }
  }
done:
  stats[0] = steps;
  stats[1] = events;
  stats[2] = work;
  free(X); free(O); free(G); free(Q); free(push); free(root); free(x); free(v); free(next_x); free(next_v); free(shut);
  return result;
}
