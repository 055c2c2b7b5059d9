// The native matches for Python: classes Matches, Rows and Batch.
#pragma once

#include <nanobind/nanobind.h>

void bind_matches(nanobind::module_ &module);
