// Stands in for Boost.Filesystem.
#pragma once

#include <filesystem>

namespace boost {
namespace filesystem = std::filesystem;
}
