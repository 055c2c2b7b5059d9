// Stands in for SDL_ttf, see SDL.h: a font whose letters are as high as they are wide.
#pragma once

#include <cstring>

#include "SDL.h"

struct TTF_Font {
  int size, outline = 0;
};

inline int TTF_Init() { return 0; }
inline void TTF_Quit() {}
inline TTF_Font *TTF_OpenFontIndexRW(SDL_RWops *, int, int size, int) { return new TTF_Font{size}; }
inline void TTF_CloseFont(TTF_Font *font) { delete font; }
inline void TTF_SetFontOutline(TTF_Font *font, int outline) { font->outline = outline; }
inline int TTF_GetFontOutline(const TTF_Font *font) { return font->outline; }
inline int TTF_SizeUTF8(TTF_Font *font, const char *text, int *width, int *height) {
  *width = font->size * static_cast<int>(std::strlen(text));
  *height = font->size;
  return 0;
}
inline SDL_Surface *TTF_RenderUTF8_Blended(TTF_Font *font, const char *text, SDL_Color) {
  int width, height;
  TTF_SizeUTF8(font, text, &width, &height);
  return new SDL_Surface(width, height);
}
