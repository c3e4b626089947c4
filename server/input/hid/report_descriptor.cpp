#include "server/input/hid/report_descriptor.hpp"

#include <algorithm>

namespace incise::input {
namespace {

// Item tags with their type, 6.2.2.4 - 6.2.2.8: the prefix byte without its two size bits.
enum Item : std::uint8_t {
  kInput = 0x80,
  kOutput = 0x90,
  kFeature = 0xb0,
  kCollection = 0xa0,
  kEndCollection = 0xc0,
  kUsagePage = 0x04,
  kLogicalMin = 0x14,
  kLogicalMax = 0x24,
  kPhysicalMin = 0x34,
  kPhysicalMax = 0x44,
  kUnitExponent = 0x54,
  kUnit = 0x64,
  kReportSize = 0x74,
  kReportId = 0x84,
  kReportCount = 0x94,
  kPush = 0xa4,
  kPop = 0xb4,
  kUsage = 0x08,
  kUsageMin = 0x18,
  kUsageMax = 0x28,
  kLongItem = 0xfc,
};
// The bits of an item with its type.
constexpr std::uint8_t kItemType = 0x0c, kMain = 0x00, kGlobal = 0x04, kLocal = 0x08;

constexpr std::size_t kMaxPushed = 16, kMaxNested = 32, kMaxUsages = 1024;
constexpr std::uint32_t kConstant = 1, kVariable = 2, kRelative = 4;

struct Globals {
  std::uint32_t usage_page = 0, report_size = 0, report_count = 0, unit = 0;
  std::int32_t logical_min = 0, logical_max = 0, physical_min = 0, physical_max = 0;
  // A maximum's sign depends on its minimum's, which may come later: kept raw too.
  std::uint32_t logical_max_raw = 0, physical_max_raw = 0;
  std::int8_t unit_exponent = 0;
  std::uint8_t report_id = 0;
};

class Parser {
 public:
  explicit Parser(std::string& error) : error_(error) {}

  std::optional<ReportDescriptor> parse(std::span<const std::uint8_t> bytes) {
    if (bytes.size() > kMaxDescriptorBytes) return refuse("longer than 4096 bytes");
    std::size_t at = 0;
    while (at < bytes.size()) {
      const std::uint8_t prefix = bytes[at++];
      if ((prefix & kLongItem) == kLongItem) {  // 6.2.2.3: length, tag, data; no long item is defined
        if (at + 2 > bytes.size() || at + 2 + bytes[at] > bytes.size()) return refuse("ends within an item");
        at += 2u + bytes[at];
        continue;
      }
      const std::size_t size = (prefix & 3) == 3 ? 4 : prefix & 3;
      if (at + size > bytes.size()) return refuse("ends within an item");
      std::uint32_t data = 0;
      for (std::size_t i = 0; i < size; ++i) data |= std::uint32_t{bytes[at + i]} << (8 * i);
      at += size;
      if (!handle_item(prefix & 0xfc, data, size)) return std::nullopt;
    }
    if (!collections_.empty()) return refuse("ends within a collection");
    if (made_.reports.empty()) return refuse("describes no report");
    const bool numbered = made_.reports.front().id != 0;
    for (const auto& report : made_.reports) {
      if ((report.id != 0) != numbered) return refuse("numbers some of its reports and not others");
    }
    for (auto& report : made_.reports) report.bytes = (report.bytes + 7) / 8;
    return std::move(made_);
  }

 private:
  std::nullopt_t refuse(const char* why) {
    error_ = why;
    return std::nullopt;
  }
  bool fail(const char* why) {
    error_ = why;
    return false;
  }

  static std::int32_t signed_of(std::uint32_t data, std::size_t size) {
    if (size == 1) return static_cast<std::int8_t>(data);
    if (size == 2) return static_cast<std::int16_t>(data);
    return static_cast<std::int32_t>(data);
  }
  // 6.2.2.7: a maximum is signed where its minimum is negative. Many devices write 255 as one byte.
  static std::int32_t maximum_of(std::int32_t minimum, std::int32_t as_signed, std::uint32_t raw) {
    if (minimum < 0 || as_signed >= 0) return as_signed;
    return raw <= 0x7fffffff ? static_cast<std::int32_t>(raw) : INT32_MAX;
  }

  bool handle_item(std::uint8_t item, std::uint32_t data, std::size_t size) {
    switch (item & kItemType) {
      case kMain:
        return handle_main(item, data);
      case kGlobal:
        return handle_global(item, data, size);
      case kLocal:
        return handle_local(item, data, size);
      default:
        return true;  // reserved
    }
  }

  // 6.2.2.7
  bool handle_global(std::uint8_t item, std::uint32_t data, std::size_t size) {
    switch (item) {
      case kUsagePage:
        globals_.usage_page = data & 0xffff;
        return true;
      case kLogicalMin:
        globals_.logical_min = signed_of(data, size);
        return true;
      case kLogicalMax:
        globals_.logical_max = signed_of(data, size);
        globals_.logical_max_raw = data;
        return true;
      case kPhysicalMin:
        globals_.physical_min = signed_of(data, size);
        return true;
      case kPhysicalMax:
        globals_.physical_max = signed_of(data, size);
        globals_.physical_max_raw = data;
        return true;
      case kUnitExponent:  // a nibble in two's complement
        globals_.unit_exponent = static_cast<std::int8_t>((data & 0xf) < 8 ? data & 0xf : (data & 0xf) - 16);
        return true;
      case kUnit:
        globals_.unit = data;
        return true;
      case kReportSize:
        globals_.report_size = data;
        return true;
      case kReportCount:
        globals_.report_count = data;
        return true;
      case kReportId:
        if (data == 0 || data > 255) return fail("has a report number that is not 1 to 255");
        globals_.report_id = static_cast<std::uint8_t>(data);
        return true;
      case kPush:
        if (pushed_.size() == kMaxPushed) return fail("pushes more than 16 times");
        pushed_.push_back(globals_);
        return true;
      case kPop:
        if (pushed_.empty()) return fail("pops what was not pushed");
        globals_ = pushed_.back();
        pushed_.pop_back();
        return true;
      default:
        return true;
    }
  }

  // 6.2.2.8. Designators and strings do not affect the layout.
  bool handle_local(std::uint8_t item, std::uint32_t data, std::size_t size) {
    switch (item) {
      case kUsage:
        if (usages_.size() == kMaxUsages) return fail("has more than 1024 usages for one item");
        usages_.push_back(whole_usage(data, size));
        return true;
      case kUsageMin:
        usage_min_ = whole_usage(data, size);
        return true;
      case kUsageMax:
        return add_range(whole_usage(data, size));
      default:
        return true;
    }
  }

  // 6.2.2.4
  bool handle_main(std::uint8_t item, std::uint32_t data) {
    switch (item) {
      case kCollection:
        return open(data);
      case kEndCollection:
        if (collections_.empty()) return fail("ends a collection that was not begun");
        collections_.pop_back();
        clear_locals();
        return true;
      case kInput:
        return add(DescribedField::Kind::kInput, data);
      case kOutput:
        return add(DescribedField::Kind::kOutput, data);
      case kFeature:
        return add(DescribedField::Kind::kFeature, data);
      default:
        return true;
    }
  }

  std::uint32_t whole_usage(std::uint32_t data, std::size_t size) const {
    return size == 4 ? data : globals_.usage_page << 16 | data;
  }

  bool add_range(std::uint32_t last) {
    if (last < usage_min_) return fail("has a usage range that ends before it begins");
    // A range longer than any item can use names nothing (some devices say 0 ... 65535).
    for (std::uint32_t u = usage_min_; usages_.size() < kMaxUsages; ++u) {
      usages_.push_back(u);
      if (u == last) break;
    }
    return true;
  }

  bool open(std::uint32_t type) {
    if (collections_.size() == kMaxNested) return fail("nests collections more than 32 deep");
    const std::uint32_t usage = usages_.empty() ? 0 : usages_.front();
    const bool application = type == 1;
    if (application) made_.applications.push_back(usage);
    collections_.push_back(application ? usage : collections_.empty() ? 0 : collections_.back());
    clear_locals();
    return true;
  }

  bool add(DescribedField::Kind kind, std::uint32_t flags) {
    ReportDescriptor::Report& report = report_of(kind);
    const std::uint64_t end =
        report.bytes + std::uint64_t{globals_.report_size} * globals_.report_count;  // bits, until the end
    if (globals_.report_size > 8 * kMaxReportBytes || end > 8 * kMaxReportBytes) {
      return fail("has a report longer than 16384 bytes");
    }
    // An array's entries are indices, not values; constants are padding; wider fields are opaque.
    const bool values = (flags & kConstant) == 0 && (flags & kVariable) != 0 && globals_.report_size >= 1 &&
                        globals_.report_size <= 32 && !usages_.empty();
    for (std::uint32_t i = 0; values && i < globals_.report_count; ++i) {
      if (made_.fields.size() == kMaxDescribedFields) return fail("has more than 4096 fields");
      DescribedField field;
      field.kind = kind;
      field.report_id = globals_.report_id;
      field.bit = report.bytes + i * globals_.report_size;
      field.bits = static_cast<std::uint8_t>(globals_.report_size);
      field.usage = usages_[std::min<std::size_t>(i, usages_.size() - 1)];  // 6.2.2.8: the last one repeats
      field.application = collections_.empty() ? 0 : collections_.back();
      field.logical_min = globals_.logical_min;
      field.logical_max = maximum_of(globals_.logical_min, globals_.logical_max, globals_.logical_max_raw);
      field.physical_min = globals_.physical_min;
      field.physical_max =
          maximum_of(globals_.physical_min, globals_.physical_max, globals_.physical_max_raw);
      field.unit = globals_.unit;
      field.unit_exponent = globals_.unit_exponent;
      field.relative = (flags & kRelative) != 0;
      made_.fields.push_back(field);
    }
    report.bytes = static_cast<std::uint32_t>(end);
    clear_locals();
    return true;
  }

  // While parsing, Report::bytes counts bits.
  ReportDescriptor::Report& report_of(DescribedField::Kind kind) {
    for (auto& report : made_.reports) {
      if (report.kind == kind && report.id == globals_.report_id) return report;
    }
    return made_.reports.emplace_back(
        ReportDescriptor::Report{kind, globals_.report_id, globals_.report_id != 0 ? 8u : 0u});
  }

  void clear_locals() {
    usages_.clear();
    usage_min_ = 0;
  }

  std::string& error_;
  ReportDescriptor made_;
  Globals globals_;
  std::vector<Globals> pushed_;
  std::vector<std::uint32_t> collections_;  // the application around each
  std::vector<std::uint32_t> usages_;
  std::uint32_t usage_min_ = 0;
};

}  // namespace

std::uint32_t ReportDescriptor::bytes_of(DescribedField::Kind kind, std::uint8_t id) const {
  for (const Report& report : reports) {
    if (report.kind == kind && report.id == id) return report.bytes;
  }
  return 0;
}

std::optional<ReportDescriptor> parse_report_descriptor(std::span<const std::uint8_t> bytes,
                                                        std::string& error) {
  return Parser(error).parse(bytes);
}

}  // namespace incise::input
