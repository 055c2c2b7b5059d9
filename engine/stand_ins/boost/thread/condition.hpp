// Stands in for a header of Boost.
#pragma once

#include <condition_variable>

namespace boost {
using condition = std::condition_variable;
}
