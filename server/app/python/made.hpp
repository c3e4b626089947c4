#pragma once

// Python can make an object without calling what fills it: Body.__new__(Body), or a subclass that uses itself before super().__init__().
// pybind11 then hands memory that nothing has been written to to the bound function. These casters refuse such an object with a TypeError, as
// `self` and as an argument.

#include <pybind11/pybind11.h>

#include <concepts>
#include <memory>
#include <string>

namespace incise::core {
struct Delta;
}

namespace incise::python {

struct Body;
struct Motion;
struct Session;
struct Cut;

// What makes an object of a class of the module, for the message.
template <class T>
inline constexpr const char* kMadeBy = nullptr;
template <>
inline constexpr const char* kMadeBy<Body> = "Body(points, tets), Body.load() or Body.phantom()";
template <>
inline constexpr const char* kMadeBy<Motion> = "Motion(poses), Motion.lines() or Motion.load()";
template <>
inline constexpr const char* kMadeBy<core::Delta> = "Session.cut(), Session.advance() or Session.deform()";
template <>
inline constexpr const char* kMadeBy<Session> = "Session(body)";
template <>
inline constexpr const char* kMadeBy<Cut> = "cut() or Session.cut()";

template <class T>
concept ModuleClass = kMadeBy<T>
!= nullptr;

template <ModuleClass T>
void require_made(pybind11::handle object) {
  if (!object || !pybind11::isinstance<T>(object)) return;  // the caster says what is wrong with it
  auto* const instance = reinterpret_cast<pybind11::detail::instance*>(object.ptr());
  const auto* const type = pybind11::detail::get_type_info(typeid(T));
  if (instance->get_value_and_holder(type).holder_constructed()) return;
  const auto name = pybind11::type::of<T>().attr("__name__").template cast<std::string>();
  throw pybind11::type_error("this incise." + name +
                             " is empty, since only __new__() was called; make one with " + kMadeBy<T> +
                             ", and in a subclass call super().__init__() first");
}

}  // namespace incise::python

namespace pybind11::detail {

template <incise::python::ModuleClass T>
class type_caster<T> : public type_caster_base<T> {
 public:
  bool load(handle object, bool convert) {
    incise::python::require_made<T>(object);
    return type_caster_base<T>::load(object, convert);
  }
};

template <incise::python::ModuleClass T>
class type_caster<std::shared_ptr<T>> : public copyable_holder_caster<T, std::shared_ptr<T>> {
 public:
  bool load(handle object, bool convert) {
    incise::python::require_made<T>(object);
    return copyable_holder_caster<T, std::shared_ptr<T>>::load(object, convert);
  }
};

}  // namespace pybind11::detail
