// Adam (Kingma & Ba 2015) over rows of a tensor, in the order of torch.optim.Adam, |g| <= 1e18:
//
// m += (1 - beta1) (g - m)     v = beta2 v + (1 - beta2) g^2
// x -= rate / (1 - beta1^t) m / (sqrt(v) / sqrt(1 - beta2^t) + epsilon)
//
// Bound by memory: seven floats move per float of x; rows that are not visible are neither read nor
// written, and each counts its own steps t. Included only by training/kernels.cpp.
#pragma once

namespace radiant::training::RADIANT_ISA {

constexpr float kMaxGradient = 1e18f;

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
  // Copies, because a member might be one of the floats written below for all the compiler knows.
  const float beta2 = job.beta2, first_share = job.first_share, second_share = job.second_share, epsilon = job.epsilon;
  for (int64_t i = begin; i < end; ++i) {
    const float at_most = gradients[i] > kMaxGradient ? kMaxGradient : gradients[i], g = at_most < -kMaxGradient ? -kMaxGradient : at_most;
    const float m = first[i] + first_share * (g - first[i]), v = beta2 * second[i] + second_share * (g * g);
    first[i] = m;
    second[i] = v;
    x[i] -= factors.step * m / (__builtin_sqrtf(v) * factors.second + epsilon);
  }
}

// Scattered rows defeat the hardware's prefetcher: prefetching kAhead runs took a third off.
constexpr int64_t kAhead = 8;

RADIANT_INLINE void prefetch_rows(const float* values, Run run, int64_t columns) {
  const char* from = reinterpret_cast<const char*>(values + run.begin * columns);
  const int64_t bytes = (run.end - run.begin) * columns * static_cast<int64_t>(sizeof(float));
  for (int64_t at = 0; at < bytes && at < 256; at += 64) __builtin_prefetch(from + at);
}

inline void adam_rows(const AdamJob& job, int64_t begin, int64_t end) {
  const int64_t columns = job.columns;
  if (!job.runs) return adam_values(job, begin * columns, end * columns, adam_factors(job, job.step));
  for (int64_t i = begin; i < end; ++i) {
    if (i + kAhead < end) {
      prefetch_rows(job.gradients, job.runs[i + kAhead], columns);
      prefetch_rows(job.parameters, job.runs[i + kAhead], columns);
      prefetch_rows(job.first_moments, job.runs[i + kAhead], columns);
      prefetch_rows(job.second_moments, job.runs[i + kAhead], columns);
    }
    const Run run = job.runs[i];
    adam_values(job, run.begin * columns, run.end * columns, adam_factors(job, job.steps[run.begin]));
  }
}

// The bits of |value| are in the order of the values, NaN last, under any floating-point option.
RADIANT_INLINE int32_t size_bits(float value) {
  int32_t bits;
  memcpy(&bits, &value, sizeof bits);
  return bits & 0x7fffffff;
}

// Adds the values at begin to end; the index is searched only where there is one.
RADIANT_INLINE void add_beyond(const float* values, int64_t begin, int64_t end, int32_t largest, Found& found) {
  int32_t beyond = 0;
  for (int64_t i = begin; i < end; ++i) beyond += size_bits(values[i]) > largest;
  if (beyond == 0) return;
  found.count += beyond;
  for (int64_t i = begin; found.first < 0; ++i) {
    if (size_bits(values[i]) > largest) found.first = i;
  }
}

inline Found rows_beyond(const float* values, const Run* runs, int64_t columns, int64_t begin, int64_t end, float largest) {
  Found found{0, -1};
  const int32_t largest_bits = size_bits(largest);
  constexpr int64_t kBlock = 1 << 20;  // what 32 bits can count
  if (!runs) {
    for (int64_t at = begin * columns; at < end * columns; at += kBlock) {
      add_beyond(values, at, at + kBlock < end * columns ? at + kBlock : end * columns, largest_bits, found);
    }
    return found;
  }
  for (int64_t i = begin; i < end; ++i) {
    if (i + kAhead < end) prefetch_rows(values, runs[i + kAhead], columns);
    add_beyond(values, runs[i].begin * columns, runs[i].end * columns, largest_bits, found);
  }
  return found;
}

}  // namespace radiant::training::RADIANT_ISA
