// What exceptions_test.mjs calls: throws what it is asked to, through functions with objects to destroy, and says what was caught.
#include <cstddef>
#include <stdexcept>
#include <string>
#include <system_error>

namespace {

struct Base {
  virtual ~Base() = default;
  int filler = 1;
};
struct Other {
  virtual ~Other() = default;
  int value = 42;
};
struct Both : Base, Other {};  // a handler for Other gets another address than what was thrown

std::string text;
int live = 0;

struct Object {
  Object() { ++live; }
  Object(const Object&) { ++live; }
  ~Object() { --live; }
};
struct Thrown : std::runtime_error {
  using std::runtime_error::runtime_error;
  Object object;
};

[[gnu::noinline]] void throw_one(int kind) {
  const Object local;
  switch (kind) {
    case 1:
      throw std::invalid_argument("an argument");
    case 2:
      throw 7;
    case 3:
      throw Thrown("with an object");
    case 4:
      throw std::string("a text");
    case 5:
      throw Both();
    case 6:
      throw std::system_error(ENOENT, std::generic_category(), "a file");
    case 7:
      throw &live;
    default:
      return;
  }
}

[[gnu::noinline]] std::string inner(int kind) {
  const Object local;
  try {
    throw_one(kind);
  } catch (const std::logic_error& error) {
    return std::string("logic_error ") + error.what();
  } catch (int number) {
    return "int " + std::to_string(number);
  }
  return "nothing";
}

// Catches, throws and catches another one meanwhile, and throws the first one again.
[[gnu::noinline]] std::string middle(int kind) {
  const Object local;
  try {
    return inner(kind);
  } catch (const std::runtime_error&) {
    const Object here;
    try {
      throw_one(1);
    } catch (const std::exception& second) {
      text = std::string("meanwhile ") + second.what() + ", ";
    }
    throw;
  }
}

[[gnu::noinline]] std::string outer(int kind) {
  const Object local;
  try {
    return middle(kind);
  } catch (const std::exception& error) {
    return text + "exception " + error.what();
  } catch (const Other& other) {
    return "other " + std::to_string(other.value);
  } catch (const int* pointer) {
    return pointer == &live ? "pointer" : "another pointer";
  } catch (...) {
    return "something";
  }
}

}  // namespace

#define INCISE_EXPORT(name) extern "C" __attribute__((export_name(name)))

INCISE_EXPORT("text_of") const char* text_of(int kind) {
  text.clear();
  text = outer(kind);
  return text.c_str();
}
// Objects that were made and not destroyed.
INCISE_EXPORT("live_objects") int live_objects() {
  return live;
}
INCISE_EXPORT("throw_out") void throw_out() {
  throw_one(3);
}
