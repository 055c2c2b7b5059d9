// Stands in for Boost: the standard library's pointers under Boost's names.
#pragma once

// Upstream's files take these for included, as they are with Boost's own header.
#include <cstring>
#include <functional>
#include <iostream>
#include <memory>
#include <typeinfo>

namespace boost {
using std::shared_ptr;
using std::static_pointer_cast;
}  // namespace boost
