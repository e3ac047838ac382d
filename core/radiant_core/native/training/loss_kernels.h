// Loss and gradient of an image x against a target y by rows (Wang et al. 2004; paper Eqn. 4):
//
// E = w ((1 - lambda) |d| + lambda (a + b - a b)),  d = x - y, a = 1 - luminance, b = 1 - structure
// a = p^2 / (mean_x^2 + mean_y^2 + C1)     p = blur(d), mean_x = mean_y + p
// b = v / (var_x + var_y + C2)             q = blur(d^2), v = q - p^2, r = blur(y d)
//                                            var_x = var_y + 2 cov + v, cov = r - mean_y p
// dE/dx = w (1 - lambda) sign(d) + lambda (blur(w P) + 2 d blur(w Q) + y blur(w R))
// P, Q, R = d(a + b - a b)/d(p, q, r)
//
// SSIM is written in differences: 1 - SSIM from its five usual moments subtracts numbers near one,
// and its relative error grows without bound as image and target meet. Zero padding is symmetric,
// so the blur is its own adjoint. It goes down the columns first, four output rows from 14 input
// rows, then along the rows, whose pixels stay interleaved (a tap is three floats on). P, Q, R are
// in a ring of 14 rows: nothing of the image's size is written but the gradient. A row's arithmetic
// depends neither on its group nor on its thread. Included only by training/kernels.cpp.
#pragma once

namespace radiant::training::RADIANT_ISA {

constexpr int kRadius = 5, kTaps = 2 * kRadius + 1, kGroup = 4, kSpan = kGroup + kTaps - 1, kPad = 16;
constexpr double kWindow[kTaps] = {0.0010283800844791092, 0.007598758135239185, 0.03600077212843083, 0.10936068950970002,
                                   0.2130055377112537,    0.26601172486179436,  0.2130055377112537,  0.10936068950970002,
                                   0.03600077212843083,   0.007598758135239185, 0.0010283800844791092};
constexpr float kC1 = 0.01f * 0.01f, kC2 = 0.03f * 0.03f;

// Floats from one row of scratch to the next: kPad zeros on either side, whole vectors between.
inline int64_t row_stride(int64_t width) { return (3 * width + kLanes - 1) / kLanes * kLanes + 2 * kPad; }

inline size_t loss_scratch(int64_t width) {
  // Blurred columns of three planes, the ring, zeros, shares; doubles of the statistics fit in.
  return static_cast<size_t>(row_stride(width)) * (3 * kGroup + 3 * kSpan + 2);
}

struct Scratch {
  int64_t stride;
  float* columns;  // (3, kGroup) rows blurred down the columns
  float* ring;     // (3, kSpan) rows of P, Q, R; row y of the image at y mod kSpan
  float* zeros;    // what lies outside the image
  float* shares;   // weight of each value of one row

  Scratch(float* memory, int64_t width) : stride(row_stride(width)) {
    memset(memory, 0, sizeof(float) * loss_scratch(width));
    columns = memory + kPad;
    ring = columns + 3 * kGroup * stride;
    zeros = ring + 3 * kSpan * stride;
    shares = zeros + stride;
  }
  float* column_row(int plane, int row) const { return columns + (plane * kGroup + row) * stride; }
  float* ring_row(int plane, int64_t y) const { return ring + (plane * kSpan + y % kSpan) * stride; }
};

inline void fill_shares(const LossJob& job, int64_t y, float* shares) {
  if (!job.weights) {
    for (int64_t i = 0; i < 3 * job.width; ++i) shares[i] = job.pixel_share;
    return;
  }
  const float* weights = job.weights + y * job.width;
  for (int64_t i = 0; i < job.width; ++i) shares[3 * i] = shares[3 * i + 1] = shares[3 * i + 2] = weights[i] * job.pixel_share;
}

// Adds row `i` of kSpan times its taps to the sums of the kGroup output rows.
#define RADIANT_ADD_TAPS(sums, i, value)                                                      \
  _Pragma("GCC unroll 4") for (int o = 0; o < kGroup; ++o) {                                  \
    if (i >= o && i - o < kTaps) sums[o] += broadcast(static_cast<float>(kWindow[i - o])) * (value);\
  }

template <class Load>
RADIANT_INLINE void moments_down(const Scratch& scratch, const float* const* images, const float* const* targets, int64_t at, Load load) {
  V p[kGroup] = {}, q[kGroup] = {}, r[kGroup] = {};
  _Pragma("GCC unroll 14") for (int i = 0; i < kSpan; ++i) {
    const V y = load(targets[i] + at), d = load(images[i] + at) - y;
    const V dd = d * d, yd = y * d;
    RADIANT_ADD_TAPS(p, i, d)
    RADIANT_ADD_TAPS(q, i, dd)
    RADIANT_ADD_TAPS(r, i, yd)
  }
  _Pragma("GCC unroll 4") for (int o = 0; o < kGroup; ++o) {
    store(scratch.column_row(0, o) + at, p[o]);
    store(scratch.column_row(1, o) + at, q[o]);
    store(scratch.column_row(2, o) + at, r[o]);
  }
}

RADIANT_INLINE void plane_down(const float* const* rows, float* to, int64_t stride, int64_t at) {
  V sums[kGroup] = {};
  _Pragma("GCC unroll 14") for (int i = 0; i < kSpan; ++i) {
    const V value = loaded(rows[i] + at);
    RADIANT_ADD_TAPS(sums, i, value)
  }
  _Pragma("GCC unroll 4") for (int o = 0; o < kGroup; ++o) store(to + o * stride + at, sums[o]);
}

RADIANT_INLINE V along(const float* row) {
  V sum = {};
  _Pragma("GCC unroll 11") for (int t = 0; t < kTaps; ++t) {
    sum += broadcast(static_cast<float>(kWindow[t])) * loaded(row + 3 * (t - kRadius));
  }
  return sum;
}

struct RowSums {
  V weighted = {}, distance = {};
};

// Errors of one vector of row values; in the ring, the weighted derivatives by p, q and r.
template <class Load>
RADIANT_INLINE void errors_along(const LossJob& job, const Scratch& scratch, int row, int64_t y, int64_t at, RowSums& sums, Load load) {
  const int64_t flat = y * 3 * job.width + at;
  const V target = load(job.target + flat), distance = absolute(load(job.image + flat) - target);
  const V mean_y = load(job.means + flat), var_y = load(job.variances + flat), share = loaded(scratch.shares + at);
  const V p = along(scratch.column_row(0, row) + at), q = along(scratch.column_row(1, row) + at), r = along(scratch.column_row(2, row) + at);

  const V mean_x = mean_y + p;
  const V inverse1 = 1.0f / (mean_x * mean_x + mean_y * mean_y + kC1);
  const V a = p * p * inverse1;
  // Variances are not negative and b is at most 2, whatever rounding of large values gives.
  const V v = larger(q - p * p, V{}), cov = r - mean_y * p;
  const V inverse2 = 1.0f / (larger(2.0f * (var_y + cov) + v, V{}) + kC2);
  const V b = smaller(v * inverse2, V{} + 2.0f);

  const V scale = share * job.ssim_weight;
  const V by_q = (1.0f - a) * (1.0f - b) * inverse2, by_r = -2.0f * (1.0f - a) * b * inverse2;
  const V by_p = 2.0f * ((1.0f - b) * (p - a * mean_x) * inverse1 - p * by_q) - mean_y * by_r;
  store(scratch.ring_row(0, y) + at, scale * by_p);
  store(scratch.ring_row(1, y) + at, scale * by_q);
  store(scratch.ring_row(2, y) + at, scale * by_r);
  sums.weighted += share * (distance + job.ssim_weight * (a + b - a * b - distance));
  sums.distance += distance;
}

template <class Load>
RADIANT_INLINE V gradient_along(const LossJob& job, const Scratch& scratch, int row, int64_t y, int64_t at, Load load) {
  const int64_t flat = y * 3 * job.width + at;
  const V target = load(job.target + flat), d = load(job.image + flat) - target;
  const V step = loaded(scratch.shares + at) * (1.0f - job.ssim_weight);
  const V by_distance = d > 0.0f ? step : (d < 0.0f ? -step : V{});
  return by_distance + along(scratch.column_row(0, row) + at) + 2.0f * d * along(scratch.column_row(1, row) + at) +
         target * along(scratch.column_row(2, row) + at);
}

inline void write_row_sums(const LossJob& job, int64_t y, const RowSums& sums) {
  job.row_sums[2 * y] = added(sums.weighted);
  job.row_sums[2 * y + 1] = added(sums.distance);
}

// The derivatives of rows y to y + count (<= kGroup) into the ring; row sums from begin to end.
inline void derivative_rows(const LossJob& job, const Scratch& scratch, int64_t y, int64_t count, int64_t begin, int64_t end) {
  const int64_t values = 3 * job.width, whole = values / kLanes * kLanes;
  const float *images[kSpan], *targets[kSpan];
  for (int i = 0; i < kSpan; ++i) {
    const int64_t from = y + i - kRadius;
    const bool inside = from >= 0 && from < job.height;
    images[i] = inside ? job.image + from * values : scratch.zeros;
    targets[i] = inside ? job.target + from * values : scratch.zeros;
  }
  const PartLoad part{static_cast<int>(values - whole)};
  for (int64_t at = 0; at < whole; at += kLanes) moments_down(scratch, images, targets, at, WholeLoad{});
  if (whole < values) moments_down(scratch, images, targets, whole, part);

  for (int row = 0; row < count; ++row) {
    RowSums sums;
    if (job.weights) fill_shares(job, y + row, scratch.shares);
    for (int64_t at = 0; at < whole; at += kLanes) errors_along(job, scratch, row, y + row, at, sums, WholeLoad{});
    if (whole < values) errors_along(job, scratch, row, y + row, whole, sums, part);
    if (y + row >= begin && y + row < end) write_row_sums(job, y + row, sums);
  }
}

inline void gradient_rows(const LossJob& job, const Scratch& scratch, int64_t y, int64_t count) {
  const int64_t values = 3 * job.width, whole = values / kLanes * kLanes;
  for (int plane = 0; plane < 3; ++plane) {
    const float* rows[kSpan];
    for (int i = 0; i < kSpan; ++i) {
      const int64_t from = y + i - kRadius;
      rows[i] = from >= 0 && from < job.height ? scratch.ring_row(plane, from) : scratch.zeros;
    }
    for (int64_t at = 0; at < values; at += kLanes) plane_down(rows, scratch.column_row(plane, 0), scratch.stride, at);
  }
  const PartLoad part{static_cast<int>(values - whole)};
  for (int row = 0; row < count; ++row) {
    float* gradient = job.gradient + (y + row) * values;
    if (job.weights) fill_shares(job, y + row, scratch.shares);
    for (int64_t at = 0; at < whole; at += kLanes) store(gradient + at, gradient_along(job, scratch, row, y + row, at, WholeLoad{}));
    if (whole < values) store_part(gradient + whole, gradient_along(job, scratch, row, y + row, whole, part), part.count);
  }
}

// lambda = 0: no window, no statistics.
template <class Load>
RADIANT_INLINE V distance_along(const LossJob& job, const Scratch& scratch, int64_t y, int64_t at, RowSums& sums, Load load) {
  const int64_t flat = y * 3 * job.width + at;
  const V d = load(job.image + flat) - load(job.target + flat), share = loaded(scratch.shares + at);
  sums.weighted += share * absolute(d);
  sums.distance += absolute(d);
  return d > 0.0f ? share : (d < 0.0f ? -share : V{});
}

inline void distance_rows(const LossJob& job, const Scratch& scratch, int64_t begin, int64_t end) {
  const int64_t values = 3 * job.width, whole = values / kLanes * kLanes;
  const PartLoad part{static_cast<int>(values - whole)};
  for (int64_t y = begin; y < end; ++y) {
    if (job.weights) fill_shares(job, y, scratch.shares);
    RowSums sums;
    for (int64_t at = 0; at < whole; at += kLanes) {
      const V gradient = distance_along(job, scratch, y, at, sums, WholeLoad{});
      if (job.gradient) store(job.gradient + y * values + at, gradient);
    }
    if (whole < values) {
      const V gradient = distance_along(job, scratch, y, whole, sums, part);
      if (job.gradient) store_part(job.gradient + y * values + whole, gradient, part.count);
    }
    write_row_sums(job, y, sums);
  }
}

inline void loss_rows(const LossJob& job, int64_t begin, int64_t end, float* memory) {
  const Scratch scratch(memory, job.width);
  if (!job.weights) fill_shares(job, 0, scratch.shares);
  if (job.ssim_weight == 0) return distance_rows(job, scratch, begin, end);
  // The gradient of a row needs the derivatives of kRadius rows above and below.
  const int64_t halo = job.gradient ? kRadius : 0;
  int64_t next = begin > halo ? begin - halo : 0;
  for (int64_t y = begin; y < end; y += kGroup) {
    const int64_t count = end - y < kGroup ? end - y : kGroup;
    const int64_t last = y + count + halo < job.height ? y + count + halo : job.height;
    for (int64_t group; next < last; next += group) {
      group = last - next < kGroup ? last - next : kGroup;
      derivative_rows(job, scratch, next, group, begin, end);
    }
    if (job.gradient) gradient_rows(job, scratch, y, count);
  }
}

// Means and variances of the target in double, as var = blur(y^2) - blur(y)^2 cancels.
inline void statistics_rows(const StatisticsJob& job, int64_t begin, int64_t end, float* memory) {
  const int64_t values = 3 * job.width, stride = row_stride(job.width);
  memset(memory, 0, sizeof(float) * loss_scratch(job.width));
  double* sums = reinterpret_cast<double*>(memory) + kPad;
  double* squares = sums + stride;
  for (int64_t y = begin; y < end; ++y) {
    for (int64_t at = 0; at < values; ++at) sums[at] = squares[at] = 0;
    for (int t = 0; t < kTaps; ++t) {
      if (y + t < kRadius || y + t - kRadius >= job.height) continue;
      const float* row = job.target + (y + t - kRadius) * values;
      for (int64_t at = 0; at < values; ++at) {
        const double value = row[at];
        sums[at] += kWindow[t] * value;
        squares[at] += kWindow[t] * (value * value);
      }
    }
    for (int64_t at = 0; at < values; ++at) {
      double mean = 0, square = 0;
      for (int t = 0; t < kTaps; ++t) {
        mean += kWindow[t] * sums[at + 3 * (t - kRadius)];
        square += kWindow[t] * squares[at + 3 * (t - kRadius)];
      }
      const double variance = square - mean * mean;
      job.means[y * values + at] = static_cast<float>(mean);
      job.variances[y * values + at] = static_cast<float>(variance > 0 ? variance : 0);
    }
  }
}

}  // namespace radiant::training::RADIANT_ISA
