// Stands in for Boost.Random: the generator of the matches' random numbers.
//
// Its raw bytes are part of a match's saved state, so that layout, seeding and refilling are those
// of Boost's mersenne_twister_engine, and the numbers those of its uniform_real_distribution.
#pragma once

#include <cstddef>
#include <cstdint>

namespace boost {

class mt19937 {
 public:
  explicit mt19937(std::uint32_t value = 5489u) { seed(value); }

  void seed(std::uint32_t value) {
    x_[0] = value;
    for (i_ = 1; i_ < kSize; i_++) {
      x_[i_] = 1812433253u * (x_[i_ - 1] ^ (x_[i_ - 1] >> 30)) + static_cast<std::uint32_t>(i_);
    }
    // The lower bits of the first word are redundant: those are kept that running the generator
    // forwards and backwards would give.
    std::uint32_t y = x_[kShift - 1] ^ x_[kSize - 1];
    y = y & kUpper ? ((y ^ kXor) << 1) | 1 : y << 1;
    x_[0] = (x_[0] & kUpper) | (y & kLower);
  }

  std::uint32_t operator()() {
    if (i_ == kSize) refill();
    std::uint32_t z = x_[i_++];
    z ^= z >> 11;
    z ^= (z << 7) & 0x9d2c5680u;
    z ^= (z << 15) & 0xefc60000u;
    return z ^ (z >> 18);
  }

 private:
  static constexpr std::size_t kSize = 624, kShift = 397;
  static constexpr std::uint32_t kXor = 0x9908b0dfu, kUpper = 0x80000000u, kLower = ~kUpper;

  void refill() {
    for (std::size_t j = 0; j < kSize; j++) {
      const std::uint32_t y = (x_[j] & kUpper) | (x_[(j + 1) % kSize] & kLower);
      x_[j] = x_[(j + kShift) % kSize] ^ (y >> 1) ^ (y & 1 ? kXor : 0);
    }
    i_ = 0;
  }

  std::uint32_t x_[kSize];
  std::size_t i_;
};

template <class Real>
class uniform_real {
 public:
  template <class Engine>
  Real operator()(Engine &engine) const {
    while (true) {
      // Rounded to the divisor itself, the largest numbers would give max: they are drawn anew.
      const Real result =
          static_cast<Real>(engine()) / (static_cast<Real>(0xffffffffu) + 1) * (max_ - min_) + min_;
      if (result < max_) return result;
    }
  }

 private:
  Real min_ = 0, max_ = 1;
};

template <class Engine, class Distribution>
class variate_generator {
 public:
  variate_generator(const Engine &engine, const Distribution &distribution)
      : engine_(engine), distribution_(distribution) {}
  auto operator()() { return distribution_(engine_); }
  Engine &engine() { return engine_; }

 private:
  Engine engine_;
  Distribution distribution_;
};

}  // namespace boost
