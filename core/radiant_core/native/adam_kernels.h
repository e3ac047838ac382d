// Adam (Kingma & Ba 2015) over rows of a tensor, in the order of torch.optim.Adam:
//
//   m += (1 - beta1) (g - m)     v = beta2 v + (1 - beta2) g^2     x -= rate / (1 - beta1^t) m / (sqrt(v) / sqrt(1 - beta2^t) + epsilon)
//
// Bound by memory: seven floats move per float of x. Rows that are not visible are neither read nor written. Each row counts its own
// steps t, so that a Gaussian seen for the first time late in a run starts as one seen at once.
// Included only by training_kernels.cpp.
#pragma once

namespace radiant::training::RADIANT_ISA {

struct AdamFactors {
  float step, second;
};

RADIANT_INLINE AdamFactors adam_factors(const AdamJob& job, int64_t steps) {
  const int64_t at = (steps < job.num_factors ? steps : job.num_factors) - 1;
  return {job.rate * job.first_factors[at], job.second_factors[at]};
}

RADIANT_INLINE void adam_values(const AdamJob& job, int64_t begin, int64_t end, AdamFactors factors) {
  // Restrict: five different tensors, or the loop would not be vectorised.
  float* __restrict x = job.parameters;
  float* __restrict first = job.first_moments;
  float* __restrict second = job.second_moments;
  const float* __restrict gradients = job.gradients;
  const float keep = 1.0f - job.beta1, keep2 = 1.0f - job.beta2;
  for (int64_t i = begin; i < end; ++i) {
    const float g = gradients[i];
    const float m = first[i] + keep * (g - first[i]), v = job.beta2 * second[i] + keep2 * (g * g);
    first[i] = m;
    second[i] = v;
    x[i] -= factors.step * m / (__builtin_sqrtf(v) * factors.second + job.epsilon);
  }
}

inline void adam_rows(const AdamJob& job, int64_t begin, int64_t end) {
  if (!job.visible) return adam_values(job, begin * job.columns, end * job.columns, adam_factors(job, job.step));
  for (int64_t row = begin; row < end; ++row) {
    if (job.visible[row]) adam_values(job, row * job.columns, (row + 1) * job.columns, adam_factors(job, job.steps[row]));
  }
}

RADIANT_INLINE int64_t count_not_finite(const float* values, int64_t count) {
  // On the bits, so that no floating-point option can argue it away.
  const uint32_t* bits = reinterpret_cast<const uint32_t*>(values);
  int32_t bad = 0;
  for (int64_t i = 0; i < count; ++i) {
    uint32_t word;
    memcpy(&word, bits + i, sizeof word);
    bad += (word & 0x7f800000u) == 0x7f800000u;
  }
  return bad;
}

inline NotFinite not_finite_rows(const float* values, const bool* visible, int64_t columns, int64_t begin, int64_t end) {
  NotFinite found{0, -1};
  constexpr int64_t kBlock = 1 << 14;
  const int64_t rows_per_block = visible ? 1 : (kBlock + columns - 1) / columns;
  for (int64_t row = begin; row < end; row += rows_per_block) {
    if (visible && !visible[row]) continue;
    const int64_t rows = end - row < rows_per_block ? end - row : rows_per_block, count = rows * columns;
    const int64_t bad = count_not_finite(values + row * columns, count);
    for (int64_t i = 0; bad && found.first < 0; ++i) {
      if (count_not_finite(values + row * columns + i, 1)) found.first = row * columns + i;
    }
    found.count += bad;
  }
  return found;
}

}  // namespace radiant::training::RADIANT_ISA
