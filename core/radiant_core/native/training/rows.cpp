#include "training/rows.h"

#include <algorithm>
#include <cmath>
#include <cstring>

namespace radiant {

void gather_rows(const float* source, std::int64_t width, const std::int64_t* rows, std::int64_t count, float* target, std::int64_t columns,
                 std::int64_t first) {
  for (std::int64_t i = 0; i < count; ++i) {
    const float* from = source + rows[i] * width;
    float* to = target + i * columns + first;
    for (std::int64_t column = 0; column < width; ++column) to[column] = from[column];
  }
}

void add_rows(float* target, const std::int64_t* at, std::int64_t count, const float* values, std::int64_t columns) {
  for (std::int64_t i = 0; i < count; ++i) {
    float* to = target + at[i] * columns;
    const float* from = values + i * columns;
    for (std::int64_t column = 0; column < columns; ++column) to[column] += from[column];
  }
}

void spread_rows(const float* values, std::int64_t columns, std::int64_t first, const std::int64_t* rows, std::int64_t count, float scale,
                 float* target, std::int64_t num_target, std::int64_t width) {
  std::int64_t written = 0;
  for (std::int64_t i = 0; i < count; ++i) {
    const float* from = values + i * columns + first;
    float* to = target + rows[i] * width;
    std::memset(target + written * width, 0, (rows[i] - written) * width * sizeof(float));
    for (std::int64_t column = 0; column < width; ++column) to[column] = scale * from[column];
    written = rows[i] + 1;
  }
  std::memset(target + written * width, 0, (num_target - written) * width * sizeof(float));
}

void to_bfloat16(const float* values, std::int64_t count, std::uint16_t* target) {
  for (std::int64_t i = 0; i < count; ++i) {
    std::uint32_t bits;
    std::memcpy(&bits, values + i, sizeof bits);
    const std::uint32_t is_nan = (bits & 0x7fffffffu) > 0x7f800000u;
    target[i] = static_cast<std::uint16_t>(is_nan ? (bits >> 16) | 0x40u : (bits + 0x7fffu + ((bits >> 16) & 1u)) >> 16);
  }
}

void from_bfloat16(const std::uint16_t* values, std::int64_t count, float* target) {
  for (std::int64_t i = 0; i < count; ++i) {
    const std::uint32_t bits = static_cast<std::uint32_t>(values[i]) << 16;
    std::memcpy(target + i, &bits, sizeof bits);
  }
}

namespace {

// 2^power for -126 to 127.
float power_of_two(int power) {
  const std::uint32_t bits = static_cast<std::uint32_t>(power + 127) << 23;
  float value;
  std::memcpy(&value, &bits, sizeof value);
  return value;
}

// The least e with value < 2^e, from -kExponentBias to kExponentBias - 1, for a value of 0 or more.
int exponent_above(float value) {
  std::uint32_t bits;
  std::memcpy(&bits, &value, sizeof bits);
  return std::min(std::max(static_cast<int>(bits >> 23) - 126, -kExponentBias), kExponentBias - 1);
}

}  // namespace

void to_blocks(const float* values, std::int64_t count, std::int64_t columns, const std::int64_t* bounds, std::int64_t num_groups,
               std::uint8_t* exponents, std::int8_t* fractions) {
  for (std::int64_t i = 0; i < count; ++i) {
    for (std::int64_t group = 0; group < num_groups; ++group) {
      const float* from = values + i * columns;
      float most = 0;
      for (std::int64_t column = bounds[group]; column < bounds[group + 1]; ++column) most = std::max(most, std::fabs(from[column]));
      const int power = exponent_above(most);
      exponents[i * num_groups + group] = static_cast<std::uint8_t>(power + kExponentBias);
      const float scale = power_of_two(7 - power);
      for (std::int64_t column = bounds[group]; column < bounds[group + 1]; ++column) {
        const float scaled = std::min(std::max(std::nearbyint(from[column] * scale), -127.0f), 127.0f);
        fractions[i * columns + column] = static_cast<std::int8_t>(scaled);
      }
    }
  }
}

void from_blocks(const std::uint8_t* exponents, const std::int8_t* fractions, std::int64_t count, std::int64_t columns,
                 const std::int64_t* bounds, std::int64_t num_groups, float* values) {
  for (std::int64_t i = 0; i < count; ++i) {
    for (std::int64_t group = 0; group < num_groups; ++group) {
      const int power = std::min<int>(exponents[i * num_groups + group], 2 * kExponentBias - 1) - kExponentBias;
      const float scale = power_of_two(power - 7);
      for (std::int64_t column = bounds[group]; column < bounds[group + 1]; ++column) {
        values[i * columns + column] = scale * static_cast<float>(fractions[i * columns + column]);
      }
    }
  }
}

}  // namespace radiant
