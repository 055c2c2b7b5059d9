// Stands in for Boost's string algorithms, as far as they are used.
#pragma once

#include <algorithm>
#include <cctype>
#include <string>

namespace boost {
inline std::string to_upper_copy(std::string text) {
  std::transform(text.begin(), text.end(), text.begin(), [](unsigned char c) { return std::toupper(c); });
  return text;
}
}  // namespace boost
