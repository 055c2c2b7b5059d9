// Stands in for Boost's pointer to objects that count their references themselves.
#pragma once

#include <cstddef>
#include <utility>

namespace boost {

template <class T>
class intrusive_ptr {
 public:
  using element_type = T;

  intrusive_ptr() = default;
  intrusive_ptr(std::nullptr_t) {}
  intrusive_ptr(T *pointer) : pointer_(pointer) { acquire(); }
  intrusive_ptr(const intrusive_ptr &other) : pointer_(other.pointer_) { acquire(); }
  intrusive_ptr(intrusive_ptr &&other) noexcept : pointer_(std::exchange(other.pointer_, nullptr)) {}
  template <class U>
  intrusive_ptr(const intrusive_ptr<U> &other) : pointer_(other.get()) { acquire(); }
  ~intrusive_ptr() {
    if (pointer_) intrusive_ptr_release(pointer_);
  }

  intrusive_ptr &operator=(intrusive_ptr other) noexcept {
    std::swap(pointer_, other.pointer_);
    return *this;
  }

  void reset() { *this = intrusive_ptr(); }
  T *get() const { return pointer_; }
  T *operator->() const { return pointer_; }
  T &operator*() const { return *pointer_; }
  explicit operator bool() const { return pointer_ != nullptr; }

 private:
  void acquire() {
    if (pointer_) intrusive_ptr_add_ref(pointer_);
  }

  T *pointer_ = nullptr;
};

template <class T, class U>
bool operator==(const intrusive_ptr<T> &a, const intrusive_ptr<U> &b) {
  return a.get() == b.get();
}
template <class T, class U>
bool operator!=(const intrusive_ptr<T> &a, const intrusive_ptr<U> &b) {
  return a.get() != b.get();
}
template <class T, class U>
bool operator==(const intrusive_ptr<T> &a, U *b) {
  return a.get() == b;
}
template <class T, class U>
bool operator!=(const intrusive_ptr<T> &a, U *b) {
  return a.get() != b;
}
template <class T>
bool operator<(const intrusive_ptr<T> &a, const intrusive_ptr<T> &b) {
  return a.get() < b.get();
}

template <class T, class U>
intrusive_ptr<T> static_pointer_cast(const intrusive_ptr<U> &pointer) {
  return static_cast<T *>(pointer.get());
}

}  // namespace boost
