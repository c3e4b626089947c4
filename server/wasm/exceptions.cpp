// C++ exceptions for WebAssembly. Debian's libc++abi for wasm32 is built without them: it has the types' matching, but none of the
// functions that compiled code calls to throw and to catch. These are those functions, after the Itanium C++ ABI, section
// 2 ("Exception Handling"), and LLVM's tool convention for WebAssembly (WasmEHPrepare.cpp): a throw is the instruction of
// that name with a pointer; at a landing pad with typed handlers the compiled code calls _Unwind_CallPersonality, which reads the
// function's table (LSDA) and puts the number of the handler, or 0, where the code finds it. Unwinding itself is the engine's.
//
// Not here: std::exception_ptr, dynamic exception specifications. Thread: the one there is.

#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <exception>
#include <typeinfo>

namespace {

// In front of each thrown object; what is thrown is a pointer to this.
struct alignas(16) Header {
  std::type_info* type;
  void* (*destroy)(void*);  // WebAssembly's destructors return what they are given
  void* adjusted;           // the object as its handler's type, from a base class for example
  int handlers;             // in which it is
  bool thrown_again;        // by one of them
  Header* next_caught;
};

Header* caught = nullptr;  // the innermost handler's exception first

void* object_of(Header* header) {
  return header + 1;
}

// libc++abi's std::type_info has this function at this place (private_typeinfo.h).
struct Matcher : std::type_info {
  virtual void noop1() const;
  virtual void noop2() const;
  virtual bool can_catch(const std::type_info* thrown, void*& adjusted) const = 0;
};

std::uintptr_t read_uleb(const std::uint8_t*& at) {
  std::uintptr_t value = 0;
  for (unsigned shift = 0;; shift += 7) {
    const std::uint8_t byte = *at++;
    value |= std::uintptr_t{byte & 0x7fu} << shift;
    if ((byte & 0x80) == 0) return value;
  }
}

std::intptr_t read_sleb(const std::uint8_t*& at) {
  std::uintptr_t value = 0;
  for (unsigned shift = 0;;) {
    const std::uint8_t byte = *at++;
    value |= std::uintptr_t{byte & 0x7fu} << shift;
    shift += 7;
    if ((byte & 0x80) != 0) continue;
    if ((byte & 0x40) != 0 && shift < 8 * sizeof value) value |= ~std::uintptr_t{0} << shift;
    return static_cast<std::intptr_t>(value);
  }
}

constexpr std::uint8_t kOmitted = 0xff, kAbsolute = 0;  // DW_EH_PE_omit, DW_EH_PE_absptr

// The handler in the landing pad `index` that takes the exception, as the compiled code numbers them; 0: none.
std::uintptr_t handler_of(const std::uint8_t* table, std::uintptr_t index, Header* header) {
  if (*table++ != kOmitted) std::abort();  // WebAssembly has no addresses of landing pads
  const std::uint8_t encoding = *table++;
  if (encoding == kOmitted) return 0;
  if (encoding != kAbsolute) std::abort();
  const std::uintptr_t to_types = read_uleb(table);
  const auto* types_end = reinterpret_cast<const Matcher* const*>(table + to_types);
  ++table;  // the encoding of the entries, which are ULEB numbers whatever it says
  const std::uintptr_t length = read_uleb(table);
  const std::uint8_t* const actions = table + length;
  std::uintptr_t action = 0;
  for (std::uintptr_t i = 0; i <= index; ++i) {
    read_uleb(table);  // the landing pad
    action = read_uleb(table);
  }
  if (action == 0) return 0;
  const std::uint8_t* at = actions + (action - 1);
  while (true) {
    const std::intptr_t filter = read_sleb(at);
    if (filter > 0) {
      const Matcher* wanted = types_end[-filter];
      void* adjusted = object_of(header);
      if (wanted == nullptr || wanted->can_catch(header->type, adjusted)) {
        header->adjusted = adjusted;
        return static_cast<std::uintptr_t>(filter);
      }
    }
    const std::uint8_t* const link = at;
    const std::intptr_t next = read_sleb(at);
    if (next == 0) return 0;
    at = link + next;
  }
}

}  // namespace

extern "C" {

struct LandingPadContext {
  std::uintptr_t index;
  const std::uint8_t* table;
  std::uintptr_t selector;
};
thread_local LandingPadContext __wasm_lpad_context;

int _Unwind_CallPersonality(void* thrown) {
  __wasm_lpad_context.selector =
      handler_of(__wasm_lpad_context.table, __wasm_lpad_context.index, static_cast<Header*>(thrown));
  return 0;
}

void* __cxa_allocate_exception(std::size_t bytes) noexcept {
  auto* header = static_cast<Header*>(std::calloc(1, sizeof(Header) + bytes));
  if (header == nullptr) std::abort();
  return object_of(header);
}

void __cxa_free_exception(void* object) noexcept {
  std::free(static_cast<Header*>(object) - 1);
}

[[noreturn]] void __cxa_throw(void* object, std::type_info* type, void* (*destroy)(void*)) {
  Header* header = static_cast<Header*>(object) - 1;
  header->type = type;
  header->destroy = destroy;
  header->adjusted = object;
  __builtin_wasm_throw(0, header);
}

void* __cxa_get_exception_ptr(void* thrown) noexcept {
  return static_cast<Header*>(thrown)->adjusted;
}

void* __cxa_begin_catch(void* thrown) noexcept {
  auto* header = static_cast<Header*>(thrown);
  header->thrown_again = false;
  if (header->handlers++ == 0) {
    header->next_caught = caught;
    caught = header;
  }
  return header->adjusted;
}

void __cxa_end_catch() {
  Header* header = caught;
  if (--header->handlers > 0) return;
  caught = header->next_caught;
  if (header->thrown_again) return;  // another handler will end it
  if (header->destroy != nullptr) header->destroy(object_of(header));
  __cxa_free_exception(object_of(header));
}

[[noreturn]] void __cxa_rethrow() {
  if (caught == nullptr) std::terminate();
  caught->thrown_again = true;
  __builtin_wasm_throw(0, caught);
}

}  // extern "C"
