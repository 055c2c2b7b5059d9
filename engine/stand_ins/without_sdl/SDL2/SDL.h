// Stands in for SDL where nothing is drawn: surfaces have a size, and no pixels.
//
// The engine prepares its menu and scoreboard in every match. With these stand-ins that costs next to
// nothing, and the library needs neither SDL nor a display. The library that renders is compiled with
// SDL's own headers instead.
#pragma once

#include <cstdint>

using Uint8 = std::uint8_t;
using Uint32 = std::uint32_t;

// What the preprocessor is asked.
#define SDL_BIG_ENDIAN 4321
#define SDL_BYTEORDER 1234

constexpr Uint32 SDL_PIXELFORMAT_RGB24 = 0, SDL_PIXELFORMAT_BGR24 = 1, SDL_PIXELFORMAT_ARGB8888 = 2,
                 SDL_PIXELFORMAT_ABGR8888 = 3;

struct SDL_PixelFormat {
  Uint32 format = SDL_PIXELFORMAT_ABGR8888;
};

struct SDL_Surface {
  SDL_Surface(int width, int height) : w(width), h(height) {}

  SDL_PixelFormat own_format;
  SDL_PixelFormat *format = &own_format;
  int w, h;
};

struct SDL_Rect {
  int x, y, w, h;
};

struct SDL_Color {
  Uint8 r, g, b, a;
};

struct SDL_RWops;
struct TTF_Font;

inline void SDL_FreeSurface(SDL_Surface *surface) { delete surface; }
inline SDL_Surface *SDL_ConvertSurface(SDL_Surface *surface, const SDL_PixelFormat *, Uint32) {
  return new SDL_Surface(surface->w, surface->h);
}
inline SDL_Surface *SDL_ConvertSurfaceFormat(SDL_Surface *surface, Uint32, Uint32) {
  return new SDL_Surface(surface->w, surface->h);
}
inline int SDL_BlitSurface(SDL_Surface *, const SDL_Rect *, SDL_Surface *, SDL_Rect *) { return 0; }
inline Uint32 SDL_MapRGB(const SDL_PixelFormat *, Uint8, Uint8, Uint8) { return 0; }
inline Uint32 SDL_MapRGBA(const SDL_PixelFormat *, Uint8, Uint8, Uint8, Uint8) { return 0; }
constexpr bool SDL_ISPIXELFORMAT_ALPHA(Uint32) { return true; }
inline SDL_RWops *SDL_RWFromConstMem(const void *, int) { return nullptr; }
inline SDL_Surface *SDL_LoadBMP_RW(SDL_RWops *, int) { return new SDL_Surface(1, 1); }
inline void SDL_Quit() {}
