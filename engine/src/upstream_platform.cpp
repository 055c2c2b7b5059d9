// What the engine asks of the system, in place of upstream's base/log.cpp, cmake/file.cpp and
// cmake/backtrace.cpp: nothing is printed, and what can't go on is an exception, not the process's end.

#include <filesystem>
#include <fstream>
#include <stdexcept>

#include "backtrace.h"
#include "base/log.hpp"
#include "file.h"
#include "main.hpp"

namespace blunted {

void Log(e_LogType type, std::string class_name, std::string method, std::string message) {
  if (type == e_FatalError) {
    throw std::runtime_error(class_name + "::" + method + ": " + message);
  }
}

}  // namespace blunted

// Upstream's handler of SIGSEGV would take the place of Python's faulthandler.
void install_stacktrace() {}
void print_stacktrace() {}

std::string GetFile(const std::string &name) {
  std::ifstream file(name, std::ios::binary | std::ios::ate);
  if (!file) throw std::runtime_error("The engine's file " + name + " can't be read.");
  std::string content(static_cast<std::size_t>(file.tellg()), '\0');
  file.seekg(0);
  file.read(content.data(), static_cast<std::streamsize>(content.size()));
  return content;
}

void GetFiles(std::string path, const std::string &extension, std::vector<std::string> &files) {
  const std::filesystem::path folder = GetGameConfig().updatePath(path);
  for (const auto &entry : std::filesystem::recursive_directory_iterator(folder)) {
    if (!entry.is_directory() && entry.path().extension() == "." + extension) {
      files.push_back(entry.path().string());
    }
  }
}
