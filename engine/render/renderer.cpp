// The Python module fbrl_engine_render._native: the engine, compiled with what it draws with.

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/string.h>

#include <algorithm>
#include <list>
#include <memory>
#include <stdexcept>
#include <thread>

#include "../src/match.hpp"
#include "scene/objects/camera.hpp"
#include "scene/scene3d/scene3d.hpp"
#include "systems/graphics/rendering/opengl_renderer3d.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace blunted {

Renderer3D *CreateRenderer() { return new OpenGLRenderer3D(); }

}  // namespace blunted

namespace {

constexpr int kLargestSide = 8192;

// An array of numpy's that owns its numbers.
template <typename T, typename... Shape>
auto new_array(Shape... shape) {
  const std::size_t sizes[] = {static_cast<std::size_t>(shape)...};
  T *numbers = new T[(static_cast<std::size_t>(shape) * ...)];
  nb::capsule owner(numbers, [](void *array) noexcept { delete[] static_cast<T *>(array); });
  return nb::ndarray<nb::numpy, T, nb::ndim<sizeof...(Shape)>>(numbers, sizeof...(Shape), sizes, owner);
}

class Renderer {
 public:
  Renderer(int width, int height, const std::string &data_dir)
      : env_(start(width, height, data_dir)), match_(env_) {}

  void reset(const ScenarioConfig &config) {
    check_thread();
    match_.reset(config);
    is_drawn_ = false;
  }

  void step(int action, bool draw, int frame_skip) {
    check_thread();
    if (action < 0 || action >= fbrl::kNumActions) {
      throw std::invalid_argument("There is no action " + std::to_string(action) + ".");
    }
    env_->game_config.render = draw;
    match_.step(action, frame_skip);
    env_->game_config.render = true;
    is_drawn_ = draw;
  }

  void set_state(const nb::bytes &state) {
    check_thread();
    // Its rules go on from what is seen, which is enough to look at.
    match_.restore({{state.c_str(), state.size()}, 0, 0, -1, -1});
    is_drawn_ = false;
  }

  auto positions() const {
    const SharedInfo &info = match_.info();
    auto array = new_array<float>(3 + 2 * (info.left_team.size() + info.right_team.size()));
    float *next = array.data();
    for (int axis = 0; axis < 3; axis++) *next++ = info.ball_position.env_coord(axis);
    for (const auto *team : {&info.left_team, &info.right_team}) {
      for (const PlayerInfo &player : *team) {
        for (int axis = 0; axis < 2; axis++) *next++ = player.player_position.env_coord(axis);
      }
    }
    return array;
  }

  auto render() {
    check_thread();
    if (!is_drawn_) draw();
    is_drawn_ = true;
    const std::string screen = env_->get_frame();
    const int width = env_->game_config.render_resolution_x;
    const int height = env_->game_config.render_resolution_y;
    auto frame = new_array<std::uint8_t>(height, width, 3);
    const int row = 3 * width;
    // OpenGL's first row is the lowest.
    for (int y = 0; y < height; y++) {
      std::copy_n(screen.data() + (height - 1 - y) * row, row, frame.data() + y * row);
    }
    return frame;
  }

 private:
  static GameEnv *start(int width, int height, const std::string &data_dir) {
    if (std::min(width, height) < 1 || std::max(width, height) > kLargestSide) {
      throw std::invalid_argument("Frames can't be of " + std::to_string(width) + "x" +
                                  std::to_string(height) + " pixels: a side has 1 to " +
                                  std::to_string(kLargestSide) + ".");
    }
    static bool is_started = false;
    if (is_started) {
      throw std::runtime_error(
          "This process has made its Renderer: the engine can draw in one instance of a process "
          "only. Use that one, or another process.");
    }
    auto env = std::make_unique<GameEnv>();
    env->game_config.data_dir = data_dir;
    env->game_config.render = true;
    env->game_config.render_resolution_x = width;
    env->game_config.render_resolution_y = height;
    env->start_game();
    is_started = true;
    return env.release();
  }

  void check_thread() const {
    if (std::this_thread::get_id() != thread_) {
      throw std::runtime_error("A Renderer belongs to the thread that made it, as OpenGL does.");
    }
  }

  void draw() {
    ContextHolder holder(env_);
    // Upstream draws with the field of view of the picture before, which is another state's here.
    env_->context->gameTask->PrepareRender();
    std::list<boost::intrusive_ptr<blunted::Camera>> cameras;
    GetScene3D()->GetObjects<blunted::Camera>(blunted::e_ObjectType_Camera, cameras);
    GetGraphicsSystem()->GetRenderer3D()->SetFOV(cameras.front()->GetFOV());
    env_->render(true);
  }

  const std::thread::id thread_ = std::this_thread::get_id();
  GameEnv *const env_;
  fbrl::Match match_;
  // Whether the last picture is of what the match has come to.
  bool is_drawn_ = false;
};

}  // namespace

NB_MODULE(_native, module) {
  nb::set_leak_warnings(false);
  const nb::call_guard<nb::gil_scoped_release> parallel;
  nb::class_<Renderer>(module, "Renderer")
      .def(nb::init<int, int, const std::string &>(), "width"_a, "height"_a, "data_dir"_a)
      .def("reset", &Renderer::reset, "config"_a, parallel,
           "Starts an episode of a fbrl_engine ScenarioConfig and plays on until the game is in play.")
      .def("step", &Renderer::step, "action"_a, "draw"_a = true, "frame_skip"_a = 1, parallel,
           "Plays frame_skip times 100 ms, and on until the game is in play.\n\n"
           "Args:\n"
           "    action: In [0, 19], as those of fbrl_engine's matches.\n"
           "    draw: Whether it is to be seen; drawing takes a hundred times as long as playing.\n"
           "    frame_skip: As that of fbrl_engine's matches; each of its frames is drawn.\n")
      .def("set_state", &Renderer::set_state, "state"_a,
           "Shows a state of the episode that was reset to.\n\n"
           "Args:\n"
           "    state: Bytes, the engine's part of a match's state. Messages over the picture, such\n"
           "        as that of a goal, are no part of it.\n\n"
           "Raises:\n"
           "    ValueError: It is another scenario's, or another seed's, as far as can be seen.\n")
      .def("positions", &Renderer::positions,
           "Float32 (3 + 2 * players,): x, y, z of the ball, then x, y of each player, left team first.")
      .def("render", &Renderer::render,
           "What is shown: red, green and blue, uint8 (height, width, 3), the upper row first.");
}
