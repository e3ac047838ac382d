// Memory that outlives a call: growing arrays in huge pages, and blocks that return to a pool when Python lets go of them.
#pragma once

#include <cstddef>
#include <cstdint>
#include <utility>

namespace radiant {

// Bytes from the system, in 2 MiB pages where they are large; throws std::bad_alloc. Contents are undefined.
void* allocate_pages(std::size_t bytes);
void free_pages(void* memory) noexcept;

// A block of the pool of at least `bytes`: the smallest free one that is not twice as large, else a new one.
void* pool_take(std::size_t bytes);
void pool_return(void* memory) noexcept;

// An array that grows and never shrinks; growing loses the contents. Never null once reserved, even for no elements.
template <class T>
class Buffer {
 public:
  Buffer() = default;
  Buffer(Buffer&& other) noexcept : data_(std::exchange(other.data_, nullptr)), capacity_(std::exchange(other.capacity_, 0)) {}
  Buffer(const Buffer&) = delete;
  Buffer& operator=(const Buffer&) = delete;
  Buffer& operator=(Buffer&&) = delete;
  ~Buffer() { free_pages(data_); }

  T* reserve(std::size_t count) {
    if (count > capacity_ || !data_) {
      // A quarter more than asked for, since the next view needs about as much.
      const std::size_t capacity = count + count / 4 + 64;
      free_pages(std::exchange(data_, nullptr));
      capacity_ = 0;
      data_ = static_cast<T*>(allocate_pages(capacity * sizeof(T)));
      capacity_ = capacity;
    }
    return data_;
  }
  void swap(Buffer& other) noexcept {
    std::swap(data_, other.data_);
    std::swap(capacity_, other.capacity_);
  }
  T* data() const { return data_; }
  std::size_t capacity() const { return capacity_; }

 private:
  T* data_ = nullptr;
  std::size_t capacity_ = 0;
};

}  // namespace radiant
