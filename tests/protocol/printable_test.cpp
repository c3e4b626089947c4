#include "protocol/printable.hpp"

#include <gtest/gtest.h>

#include <string>

namespace incise::protocol {
namespace {

TEST(Printable, KeepsUtf8) {
  for (const char* name : {"", "left hand", "Dr. M\u00fcller", "\u5de6\u624b", "\U0001f52a 2"})
    EXPECT_EQ(printable(name), name);
}

TEST(Printable, PutsAQuestionMarkForWhatIsNotToBeSeen) {
  EXPECT_EQ(printable("a\x1b[31m\n\"b\x7f"), "a?[31m??b?");
  EXPECT_EQ(printable("a\u0085\u202e\u200b\ufeff\U000e0041z"), "a?????z");
  // Cut off, longer than need be, a surrogate, beyond the last one, a byte of Latin-1, a byte that continues nothing.
  EXPECT_EQ(printable("\xe5\xb7"), "??");
  EXPECT_EQ(printable("\xc0\xaf"), "??");
  EXPECT_EQ(printable("\xe0\x80\xaf"), "???");
  EXPECT_EQ(printable("\xed\xa0\x80"), "???");
  EXPECT_EQ(printable("\xf4\x90\x80\x80"), "????");
  EXPECT_EQ(printable("M\xfcller"), "M?ller");
  EXPECT_EQ(printable("\x80x"), "?x");
}

TEST(Printable, CutsBetweenCharacters) {
  EXPECT_EQ(printable("\u5de6\u624b\u624b", 2), "\u5de6\u624b");
  EXPECT_EQ(printable("abc", 3), "abc");
  EXPECT_EQ(printable("abc", 0), "");
  EXPECT_EQ(characters("\u5de6\u624b"), 2u);
  EXPECT_EQ(characters("a\u00fc\U0001f52a"), 3u);
}

}  // namespace
}  // namespace incise::protocol
