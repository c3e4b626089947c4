#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

namespace incise::protocol {

// CRC-32C (Castagnoli: polynomial 0x1EDC6F41, reflected, initial value and final XOR all ones) of the parts
// one after the other, as in iSCSI (RFC 3720): of "123456789" it is 0xE3069283. Linear in the bytes,
// eight at a time.
std::uint32_t crc32c(std::span<const std::byte> first, std::span<const std::byte> second = {});

}  // namespace incise::protocol
