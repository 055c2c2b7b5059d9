// Stands in for SDL, see SDL.h.
#pragma once

#include "SDL.h"
