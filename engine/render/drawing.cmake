# What upstream's drawing is compiled and linked with: the target `drawing`.

set(MISSING "")
foreach(NEEDED
    "SDL2 SDL2/SDL.h libsdl2-dev"
    "SDL2_ttf SDL2/SDL_ttf.h libsdl2-ttf-dev"
    "SDL2_gfx SDL2/SDL2_rotozoom.h libsdl2-gfx-dev"
    "EGL EGL/egl.h libegl-dev"
    "GL GL/glext.h libgl-dev")  # its headers alone: EGL hands the functions over
  separate_arguments(NEEDED)
  list(GET NEEDED 0 NAME)
  list(GET NEEDED 1 HEADER)
  list(GET NEEDED 2 PACKAGE)
  find_library(${NAME}_LIBRARY ${NAME})
  find_path(${NAME}_INCLUDE_DIR ${HEADER})
  if(${NAME}_LIBRARY AND ${NAME}_INCLUDE_DIR)
    target_link_libraries(drawing INTERFACE ${${NAME}_LIBRARY})
    target_include_directories(drawing INTERFACE ${${NAME}_INCLUDE_DIR})
  else()
    string(APPEND MISSING " ${PACKAGE}")
  endif()
endforeach()
if(MISSING)
  message(FATAL_ERROR
    "Rendering needs libraries that are not here. On Debian and Ubuntu:\n"
    "  sudo apt-get install${MISSING}")
endif()

# EGL's header would ask for those of X11.
target_compile_definitions(drawing INTERFACE EGL_NO_X11)
