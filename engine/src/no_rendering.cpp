// What the library that does not render has in place of upstream's drawing.

#include <stdexcept>

#include "base/sdl_surface.hpp"
#include "onthepitch/proceduralpitch.hpp"
#include "systems/graphics/rendering/interface_renderer3d.hpp"

namespace blunted {

Renderer3D *CreateRenderer() {
  throw std::runtime_error(
      "This engine does not render: fbrl_engine_render.Renderer does.");
}

SDL_Surface *CreateSDLSurface(int width, int height) { return new SDL_Surface(width, height); }
void sdl_rectangle_filled(SDL_Surface *, int, int, int, int, Uint32) {}
void sdl_setsurfacealpha(SDL_Surface *, int) {}

}  // namespace blunted

void GeneratePitch(int, int, int, int, int, int) {}
