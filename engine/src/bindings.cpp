// The Python module fbrl_engine._native.

#include <nanobind/nanobind.h>

#include "match_bindings.hpp"
#include "upstream_bindings.hpp"

NB_MODULE(_native, module) {
  // Matches may outlive the interpreter's last look at them; nothing is printed about that.
  nanobind::set_leak_warnings(false);
  bind_upstream(module);
  bind_matches(module);
}
