// The classes that gfootball's Python modules expect of the engine.
#pragma once

#include <nanobind/nanobind.h>

// Adds what upstream's ai.cpp binds with Boost.Python, under the same names.
void bind_upstream(nanobind::module_ &module);
