// Memory that outlives a call: growing arrays in huge pages, and blocks pooled after Python's use.
#pragma once

#include <cstddef>
#include <cstdint>
#include <utility>

namespace radiant {

// Bytes from the system, undefined, in 2 MiB pages where large; throws std::bad_alloc.
void* allocate_pages(std::size_t bytes);
void free_pages(void* memory) noexcept;

// A block of at least `bytes`: the smallest free one below twice that, else new.
void* pool_take(std::size_t bytes);
void pool_return(void* memory) noexcept;

// A block of the pool for the time of a scope.
class PooledBlock {
 public:
  explicit PooledBlock(std::size_t bytes) : memory_(pool_take(bytes)) {}
  PooledBlock(const PooledBlock&) = delete;
  PooledBlock& operator=(const PooledBlock&) = delete;
  ~PooledBlock() { pool_return(memory_); }
  void* data() const { return memory_; }

 private:
  void* memory_;
};

// An array that grows; growing loses the contents. Never null once reserved, even for no elements.
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
    size_ = count;
    if (count > capacity_ || !data_) {
      // A quarter more than asked for, since the next view needs about as much.
      const std::size_t capacity = count + count / 4 + 64;
      release();
      data_ = static_cast<T*>(allocate_pages(capacity * sizeof(T)));
      capacity_ = capacity;
    }
    return data_;
  }
  void swap(Buffer& other) noexcept {
    std::swap(data_, other.data_);
    std::swap(capacity_, other.capacity_);
  }
  void release() noexcept {
    free_pages(std::exchange(data_, nullptr));
    capacity_ = 0;
  }
  T* data() const { return data_; }
  std::size_t reserved_bytes() const { return size_ * sizeof(T); }
  std::size_t capacity_bytes() const { return capacity_ * sizeof(T); }
  std::size_t capacity() const { return capacity_; }

 private:
  T* data_ = nullptr;
  std::size_t capacity_ = 0, size_ = 0;
};

}  // namespace radiant
