// Stands in for Boost: the standard library's pointers under Boost's names.
#pragma once

#include <memory>

namespace boost {
using std::weak_ptr;
}  // namespace boost
