// Rows of tables of floats: gathered, added and spread by their indices, and made shorter to send;
// once per step of machines that train together.
#pragma once

#include <cstdint>

namespace radiant {

// target[i, first : first + width] = source[rows[i]], for (num_source, width) and (count, columns).
void gather_rows(const float* source, std::int64_t width, const std::int64_t* rows, std::int64_t count, float* target, std::int64_t columns,
                 std::int64_t first);

// target[at[i]] += values[i], for (num_target, columns) and (count, columns); in the order of i.
void add_rows(float* target, const std::int64_t* at, std::int64_t count, const float* values, std::int64_t columns);

// target[rows[i]] = scale * values[i, first : first + width] for ascending rows; the other of
// `num_target` rows become 0.
void spread_rows(const float* values, std::int64_t columns, std::int64_t first, const std::int64_t* rows, std::int64_t count, float scale,
                 float* target, std::int64_t num_target, std::int64_t width);

// The nearest bfloat16, ties to even; infinite beyond its range, NaN stays one.
void to_bfloat16(const float* values, std::int64_t count, std::uint16_t* target);

void from_bfloat16(const std::uint16_t* values, std::int64_t count, float* target);

// Values (count, columns) as blocks: for each of `num_groups` groups of columns, which begin at
// `bounds` and end with the next, an exponent e + kExponentBias with |value| < 2^e, and for each
// value the nearest multiple of 2^(e - 7), at most 127 of them.
constexpr int kExponentBias = 64;

void to_blocks(const float* values, std::int64_t count, std::int64_t columns, const std::int64_t* bounds, std::int64_t num_groups,
               std::uint8_t* exponents, std::int8_t* fractions);

void from_blocks(const std::uint8_t* exponents, const std::int8_t* fractions, std::int64_t count, std::int64_t columns,
                 const std::int64_t* bounds, std::int64_t num_groups, float* values);

}  // namespace radiant
