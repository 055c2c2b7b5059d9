// Stands in for SDL_gfx, see SDL.h.
#pragma once

#include "SDL.h"

constexpr int SMOOTHING_ON = 1;

inline SDL_Surface *zoomSurface(SDL_Surface *surface, double x, double y, int) {
  return new SDL_Surface(static_cast<int>(surface->w * x), static_cast<int>(surface->h * y));
}
