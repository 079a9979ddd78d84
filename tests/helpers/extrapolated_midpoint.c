/* Eq. (1) for laws that are sums of terms, by extrapolation of the modified midpoint rule, in the precision REAL.

Contacts c = 0 ... N: above grain 0, between grains, below grain N-1. A term with a kink has a side on every contact: the
step computes with the smooth function of that side, also a little beyond the kink, and ends where the kink is crossed. */

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <tgmath.h>

#define ROWS 8
#define GRAINS 64
#define TERMS 12

enum { POWER, ONE_SIDED, TANH, EXP, SINE, SOFT, LOG };

typedef struct {
  int grains, terms, acts, place; /* acts: 0 nothing, 1 a sine; place: -1 wall, 0 grain 0, n + 1 pushes grain n */
  const int *kind;
  const REAL *a, *b, *e, *p, *sign; /* (terms, grains + 1) */
  const REAL *rest, *exists, *mass, *mobile, *viscosity, *drag;
  REAL amplitude, omega, end;
  int side[TERMS][GRAINS + 1];
} System;

static int kinked(int kind) { return kind == ONE_SIDED || kind == LOG; }

/* Force of one term and its slope. */
static REAL term(const System *s, int i, int c, REAL o, REAL *slope) {
  int n = i * (s->grains + 1) + c;
  REAL a = s->a[n], b = s->b[n], p = s->p[n], x = s->sign[n] * (o - s->e[n]);
  switch (s->kind[i]) {
    case POWER: *slope = a * p * pow(o, p - 1); return a * pow(o, p);
    case TANH: { REAL y = tanh(b * o); *slope = a * b * (1 - y * y); return a * y; }
    case EXP: *slope = a * b * exp(b * o); return a * expm1(b * o);
    case SINE: *slope = a * b * cos(b * o); return a * sin(b * o);
    case SOFT: { REAL y = 1 + b * b * o * o, r = sqrt(y); *slope = a / (y * r); return a * o / r; }
  }
  *slope = 0;
  if (!s->side[i][c]) return 0;
  if (s->kind[i] == LOG) { *slope = s->sign[n] * a * b / (1 + b * x); return a * log1p(b * x); }
  if (p != floor(p) && x <= 0) return 0;
  *slope = s->sign[n] * a * p * pow(x, p - 1);
  return a * pow(x, p);
}

static REAL law(const System *s, int c, REAL o, REAL *slope) {
  REAL force = 0, part;
  *slope = 0;
  for (int i = 0; i < s->terms; i++) {
    force += term(s, i, c, o, &part);
    *slope += part;
  }
  return force;
}

static void imposed(const System *s, REAL t, REAL *x, REAL *rate) {
  *x = *rate = 0;
  if (s->acts && t <= s->end) {
    *x = s->amplitude * sin(s->omega * t);
    *rate = s->amplitude * s->omega * cos(s->omega * t);
  }
}

static REAL overlap(const System *s, int c, REAL t, const REAL *y) {
  REAL wall = 0, rate;
  if (s->acts && s->place < 0) imposed(s, t, &wall, &rate);
  return s->rest[c] + (c ? y[c - 1] : wall) - (c < s->grains ? y[c] : 0);
}

static void rates(const System *s, REAL t, const REAL *y, const REAL *at_rest, REAL *out) {
  int n = s->grains;
  const REAL *v = y + n;
  REAL x, rate, force[GRAINS + 1];
  imposed(s, t, &x, &rate);
  REAL wall = s->place < 0 ? rate : 0;
  for (int c = 0; c <= n; c++) {
    force[c] = 0;
    if (!s->exists[c]) continue;
    REAL slope, f = law(s, c, overlap(s, c, t, y), &slope);
    REAL closing = (c ? v[c - 1] : wall) - (c < n ? v[c] : 0);
    force[c] = f - at_rest[c] + (s->viscosity[c] ? s->viscosity[c] * slope * closing : 0);
  }
  for (int i = 0; i < n; i++) {
    REAL push = s->acts && s->place == i + 1 ? x : 0;
    out[i] = s->mobile[i] * v[i];
    out[n + i] = s->mobile[i] * ((force[i] - force[i + 1] + push) / s->mass[i] - s->drag[i] * v[i]);
  }
  if (s->acts && s->place == 0) {
    out[0] = rate;
    out[n] = t <= s->end ? -s->omega * s->omega * x : 0;
  }
}

/* How far the state is on a side that some term does not have; below 0 if every side is right. */
static REAL beyond(const System *s, REAL t, const REAL *y, int *where) {
  REAL worst = -HUGE_VAL;
  for (int i = 0; i < s->terms; i++)
    for (int c = 0; kinked(s->kind[i]) && c <= s->grains; c++) {
      if (!s->exists[c]) continue;
      int n = i * (s->grains + 1) + c;
      REAL g = s->sign[n] * (overlap(s, c, t, y) - s->e[n]);
      REAL off = s->side[i][c] ? -g : g;
      if (off > worst) { worst = off; *where = n; }
    }
  return worst;
}

typedef struct {
  REAL y[2 * GRAINS], error, beyond, middle; /* middle: fraction of the step at which a side is first wrong */
  int where;
} Step;

static void step_on(const System *s, REAL t, REAL h, const REAL *y, const REAL *at_rest, const REAL *size, REAL *peak,
                    REAL tiny, Step *out) {
  int n = s->grains, m = 2 * n;
  static REAL table[ROWS][2 * GRAINS];
  REAL first[2 * GRAINS], slope[2 * GRAINS], before[2 * GRAINS], now[2 * GRAINS];
  rates(s, t, y, at_rest, first);
  out->middle = 2;
  for (int row = 0; row < ROWS; row++) {
    int parts = 2 * (row + 1);
    REAL part = h / parts;
    memcpy(before, y, sizeof(REAL) * m);
    for (int i = 0; i < m; i++) now[i] = y[i] + part * first[i];
    for (int k = 1; k < parts; k++) {
      if (row == ROWS - 1) {
        int where;
        if (out->middle > 1 && beyond(s, t + k * part, now, &where) > tiny) out->middle = (REAL)k / parts;
        for (int i = 0; i < m; i++) peak[i >= n] = fmax(peak[i >= n], fabs(now[i]));
      }
      rates(s, t + k * part, now, at_rest, slope);
      for (int i = 0; i < m; i++) {
        REAL next = before[i] + 2 * part * slope[i];
        before[i] = now[i];
        now[i] = next;
      }
    }
    rates(s, t + h, now, at_rest, slope);
    for (int i = 0; i < m; i++) {
      REAL carried = (now[i] + before[i] + part * slope[i]) / 2;
      for (int k = 0; k <= row; k++) {
        REAL kept = table[k][i];
        table[k][i] = carried;
        if (k == row) break;
        REAL ratio = (REAL)parts / (2 * (row - k));
        carried += (carried - kept) / (ratio * ratio - 1);
      }
    }
  }
  out->error = 0;
  for (int i = 0; i < m; i++) {
    out->y[i] = table[ROWS - 1][i];
    REAL off = fabs(table[ROWS - 1][i] - table[ROWS - 2][i]) / size[i >= n];
    if (!(off <= out->error)) out->error = off;
  }
  if (s->acts && s->place == 0) imposed(s, t + h, &out->y[0], &out->y[n]);
  out->beyond = beyond(s, t + h, out->y, &out->where);
}

/* Overlaps at rest under these forces, from a first guess. Returns 0 if all are found. */
static int settle(const System *s, REAL *rest, const REAL *carried) {
  System local = *s;
  for (int c = 0; c <= s->grains; c++) {
    if (!s->exists[c]) continue;
    for (int tries = 0; tries < 200; tries++) {
      for (int i = 0; i < s->terms; i++) {
        int n = i * (s->grains + 1) + c;
        local.side[i][c] = s->sign[n] * (rest[c] - s->e[n]) > 0;
      }
      REAL slope, off = law(&local, c, rest[c], &slope) - carried[c];
      if (off == 0) break;
      if (!(slope > 0) || !isfinite(slope)) return 1;
      REAL next = rest[c] - off / slope;
      if (fabs(next - rest[c]) <= 2 * EPS * fabs(next)) { rest[c] = next; break; }
      rest[c] = next;
      /* Terms that cancel leave the last digits undecided. */
      if (tries > 10 && fabs(off / slope) <= 1e4 * EPS * fabs(next)) break;
      if (tries > 150) return 1;
    }
  }
  return 0;
}

static void choose_sides(System *s, const REAL *y, const REAL *at_rest, REAL tiny) {
  int n = s->grains;
  REAL slope[2 * GRAINS];
  memset(s->side, 0, sizeof s->side);
  for (int pass = 0; pass < 2; pass++) {
    rates(s, 0, y, at_rest, slope);
    REAL wall, rate;
    imposed(s, 0, &wall, &rate);
    for (int i = 0; i < s->terms; i++)
      for (int c = 0; kinked(s->kind[i]) && c <= n; c++) {
        if (!s->exists[c]) continue;
        int k = i * (n + 1) + c;
        REAL g = s->sign[k] * (overlap(s, c, 0, y) - s->e[k]);
        if (fabs(g) <= tiny) {
          REAL above = c ? slope[c - 1] : (s->place < 0 ? rate : 0);
          g = s->sign[k] * (above - (c < n ? slope[c] : 0));
          if (g == 0) g = s->sign[k] * ((c ? slope[n + c - 1] : 0) - (c < n ? slope[n + c] : 0));
        }
        s->side[i][c] = g > 0;
      }
  }
}

/* Returns 0, or why there is no solution: 1 too many steps, 2 a kink that is not crossed, 3 no rest. */
int integrate(int grains, int terms, const int *kind, const REAL *laws, REAL *rest, const REAL *chain, int acts, int place,
              const REAL *wave, const REAL *start, int samples, const REAL *times, double tolerance, double most_steps,
              const double *floors, double *out, double *peaks, double *stats) {
  static System s;
  int m = 2 * grains, width = terms * (grains + 1), where;
  s.grains = grains;
  s.terms = terms;
  s.kind = kind;
  s.a = laws;
  s.b = laws + width;
  s.e = laws + 2 * width;
  s.p = laws + 3 * width;
  s.sign = laws + 4 * width;
  const REAL *carried = chain;
  s.exists = chain + (grains + 1);
  s.viscosity = chain + 2 * (grains + 1);
  s.mass = chain + 3 * (grains + 1);
  s.mobile = s.mass + grains;
  s.drag = s.mobile + grains;
  s.acts = acts;
  s.place = place;
  s.amplitude = wave[0];
  s.omega = wave[1];
  s.end = wave[2];
  if (settle(&s, rest, carried)) return 3;
  s.rest = rest;
  REAL y[2 * GRAINS], at_rest[GRAINS + 1], size[2], peak[2], held[2], longest = 0;
  memcpy(y, start, sizeof(REAL) * m);
  for (int i = 0; i < 2; i++) peak[i] = floors[i];
  for (int c = 0; c <= grains; c++) longest = fmax(longest, fabs(rest[c]));
  for (int i = 0; i < m; i++) peak[i >= grains] = fmax(peak[i >= grains], fabs(y[i]));
  REAL tiny = 64 * EPS * (longest + peak[0]);
  /* Sides at rest, where the forces at rest are computed. */
  for (int i = 0; i < terms; i++)
    for (int c = 0; c <= grains; c++) {
      int n = i * (grains + 1) + c;
      s.side[i][c] = s.sign[n] * (rest[c] - s.e[n]) > 0;
    }
  for (int c = 0; c <= grains; c++) {
    REAL slope;
    at_rest[c] = s.exists[c] ? law(&s, c, rest[c], &slope) : 0;
  }
  choose_sides(&s, y, at_rest, tiny);
  REAL t = 0, next = times[samples - 1] / 1000;
  double steps = 0, events = 0;
  int stuck = 0, done = 0;
  REAL stop = 0;
  static Step trial, best;
  for (done = 0; done < samples;) {
    if (times[done] <= t) {
      for (int i = 0; i < m; i++) out[done * m + i] = (double)y[i];
      done++;
      continue;
    }
    stop = times[done];
    int kink = acts && t < s.end && s.end < stop;
    if (kink) stop = s.end;
    REAL h = fmin(next, stop - t);
    int whole = h == stop - t;
    if (++steps > most_steps) return 1;
    tiny = 64 * EPS * (longest + peak[0]);
    for (int i = 0; i < 2; i++) { size[i] = tolerance * peak[i]; held[i] = peak[i]; }
    step_on(&s, t, h, y, at_rest, size, peak, tiny, &trial);
    if (!(trial.error <= 1)) {
      memcpy(peak, held, sizeof peak);
      REAL factor = 0.85 * pow(1 / trial.error, (REAL)1 / (2 * ROWS - 1));
      next = h * (factor > 0.05 && factor < 1 ? fmin(factor, 0.7) : 0.05);
      if (next < 1e-30 * times[samples - 1]) return 2;
      continue;
    }
    REAL wanted = h * fmin(3, fmax(0.3, 0.85 * pow(1 / fmax(trial.error, 1e-30), (REAL)1 / (2 * ROWS - 1))));
    if (trial.middle > 1 && trial.beyond <= tiny) {
      t = whole ? stop : t + h;
      memcpy(y, trial.y, sizeof(REAL) * m);
      next = whole ? fmax(next, wanted) : wanted;
      stuck = 0;
      if (kink && whole) { s.end = -1; if (place == 0) y[grains] = 0; }
      continue;
    }
    /* A kink is crossed in this step. */
    memcpy(peak, held, sizeof peak);
    /* The end may have another crossing than the middle, so that the step must first end at the earlier one. */
    if (trial.middle <= 1 && (trial.beyond <= tiny || trial.middle * 2 * ROWS > 1.5)) {
      next = h * trial.middle;
      if (++stuck > 200) return 2;
      continue;
    }
    REAL part = h / (2 * ROWS), high = h;
    REAL f_high = trial.beyond, over = trial.beyond, low = (trial.middle <= 1 ? h * trial.middle : h) - part;
    best = trial;
    /* The middles of a step are less accurate than its end: look for a moment before the crossing. */
    for (; low > part / 2; low -= part) {
      step_on(&s, t, low, y, at_rest, size, peak, tiny, &trial);
      if (trial.beyond < 0) break;
      high = low;
      f_high = over = trial.beyond;
      best = trial;
    }
    if (low < part / 2) {
      low = 0;
      if (beyond(&s, t, y, &where) > -tiny) {
        /* The state is on the kink: the side is wrong if the motion leads away from it. */
        if (++stuck > 40) return 2;
        if (stuck % 4) { next = h / 16; continue; }
        int i = where / (grains + 1), c = where % (grains + 1);
        s.side[i][c] = !s.side[i][c];
        events++;
        continue;
      }
    }
    REAL f_low = -1;
    int last = 0;
    for (int k = 0; k < 100 && over > tiny && high - low > 2 * EPS * h; k++) {
      REAL at = k == 0 ? (low + high) / 2 : high - f_high * (high - low) / (f_high - f_low);
      if (!(at > low && at < high) || k % 8 == 7) at = (low + high) / 2;
      step_on(&s, t, at, y, at_rest, size, peak, tiny, &trial);
      if (trial.beyond >= 0) {
        high = at; f_high = over = trial.beyond; best = trial;
        if (last == 1) f_low /= 2;
        last = 1;
      } else {
        low = at; f_low = trial.beyond;
        if (last == -1) f_high /= 2;
        last = -1;
      }
    }
    t += high;
    memcpy(y, best.y, sizeof(REAL) * m);
    for (int i = 0; i < terms; i++)
      for (int c = 0; kinked(kind[i]) && c <= grains; c++) {
        int n = i * (grains + 1) + c;
        REAL g = s.sign[n] * (overlap(&s, c, t, y) - s.e[n]);
        if (s.exists[c] && (s.side[i][c] ? -g : g) >= 0) { s.side[i][c] = !s.side[i][c]; events++; }
      }
    next = fmin(wanted, h);
    stuck = 0;
  }
  for (int i = 0; i < 2; i++) peaks[i] = (double)peak[i];
  stats[0] = steps;
  stats[1] = events;
  return 0;
}
