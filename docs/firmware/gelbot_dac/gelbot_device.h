// The line protocol of docs/hardware.md, for a board with 16 outputs: plain C++11 that knows no pins and allocates
// nothing. The test suite compiles it and compares each answer with that of gelbot's reference device.
#pragma once

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

namespace gelbot {

const int channel_count = 16;
const long lowest_mv = -10000, highest_mv = 10000;
const uint32_t watchdog_ms = 200;
const int protocol_version = 1;
const char *const device_name = "gelbot-dac";
const int longest_request = 255, longest_answer = 511;

// CRC-16/CCITT-FALSE: of "123456789" it is 0x29B1.
inline uint16_t crc16(const char *data, int count) {
    uint16_t crc = 0xFFFF;
    for (int i = 0; i < count; ++i) {
        crc ^= (uint16_t)((uint8_t)data[i] << 8);
        for (int bit = 0; bit < 8; ++bit) crc = (crc & 0x8000) ? (uint16_t)((crc << 1) ^ 0x1021) : (uint16_t)(crc << 1);
    }
    return crc;
}

// What the board does: put all outputs on at once [mV]; measure its currents [uA], or answer false if it cannot.
struct Board {
    virtual void apply(const long *millivolts) = 0;
    virtual bool measure(long *microamperes) = 0;
};

class Device {
  public:
    explicit Device(Board &board) : board_(board) { zero(); }

    // A character that came in at `now` [ms]. After the last one of a line: the answer, a text that ends in a line feed
    // and stands until the next call; else, and for an empty line, an empty text.
    const char *take(char character, uint32_t now) {
        answer_[0] = 0;
        expire(now);
        if (character != '\n') {
            if (length_ <= longest_request) line_[length_] = character;
            if (length_ <= longest_request) ++length_;  // a line that is too long stays so until it ends
            return answer_;
        }
        int length = length_;
        length_ = 0;
        if (length > 0) respond(length, now);
        return answer_;
    }

    // All outputs to zero once no good W line has come for the time of the watchdog. Call it as often as you can.
    void expire(uint32_t now) {
        if (armed_ && now - written_ >= watchdog_ms) {
            zero();
            ++expired_count_;
        }
    }

    // Whether the watchdog runs, and since when [ms]: for an interrupt that must act when the loop does not.
    bool armed() const { return armed_; }
    uint32_t written() const { return written_; }

  private:
    void zero() {
        armed_ = false;
        memset(millivolts_, 0, sizeof millivolts_);
        board_.apply(millivolts_);
    }

    void respond(int length, uint32_t now) {
        const char *words[2 + channel_count + 1];
        int word_count = 0;
        if (length >= longest_request || !checked(length) || !split(length - 5, words, word_count)) return refuse(0, "crc");
        long number = 0;
        if (word_count < 2 || !whole(words[1], 5, false, number) || number < 1 || number > 65535) return refuse(0, "number");
        char command = words[0][1] ? 0 : words[0][0];
        if (!command || !strchr("WRZI", command)) return refuse(number, "command");
        if (word_count - 2 != (command == 'W' ? channel_count : 0)) return refuse(number, "count");
        if (command == 'I') {
            snprintf(text_, sizeof text_, "A %ld %s %d %d %ld %ld %lu", number, device_name, protocol_version,
                     channel_count, lowest_mv, highest_mv, (unsigned long)watchdog_ms);
            return send();
        }
        if (command == 'R') return read_back(number);
        if (command == 'Z') {
            zero();
            return done(number);
        }
        long asked[channel_count];
        for (int i = 0; i < channel_count; ++i)
            if (!whole(words[2 + i], 9, true, asked[i])) return refuse(number, "number");
        for (int i = 0; i < channel_count; ++i)
            if (asked[i] < lowest_mv || asked[i] > highest_mv) return refuse(number, "range");
        memcpy(millivolts_, asked, sizeof millivolts_);
        written_ = now;
        armed_ = true;
        board_.apply(millivolts_);
        done(number);
    }

    void read_back(long number) {
        long microamperes[channel_count];
        int at = snprintf(text_, sizeof text_, "A %ld %lu", number, expired_count_);
        for (int i = 0; i < channel_count; ++i) at += snprintf(text_ + at, sizeof text_ - at, " %ld", millivolts_[i]);
        if (board_.measure(microamperes))
            for (int i = 0; i < channel_count; ++i) at += snprintf(text_ + at, sizeof text_ - at, " %ld", microamperes[i]);
        send();
    }

    void done(long number) {
        snprintf(text_, sizeof text_, "A %ld %lu", number, expired_count_);
        send();
    }

    void refuse(long number, const char *reason) {
        snprintf(text_, sizeof text_, "N %ld %s", number, reason);
        send();
    }

    void send() { snprintf(answer_, sizeof answer_, "%s*%04X\n", text_, crc16(text_, (int)strlen(text_))); }

    // Whether the line ends in a star and the four digits of its checksum, capitals only.
    bool checked(int length) const {
        if (length < 6 || line_[length - 5] != '*') return false;
        char digits[5];
        snprintf(digits, sizeof digits, "%04X", crc16(line_, length - 5));
        return memcmp(digits, line_ + length - 4, 4) == 0;
    }

    // Cut the first `length` characters into words with single spaces between, and count all of them; only so many are
    // kept as a line may have. False for what no word may hold.
    bool split(int length, const char **words, int &word_count) {
        line_[length] = 0;
        word_count = 0;
        bool inside = false;
        for (int i = 0; i < length; ++i) {
            char character = line_[i];
            if (character == ' ') {
                if (!inside) return false;
                line_[i] = 0;
                inside = false;
            } else if (character <= ' ' || character > '~' || character == '*') {
                return false;
            } else if (!inside) {
                if (word_count < 2 + channel_count) words[word_count] = line_ + i;
                ++word_count;
                inside = true;
            }
        }
        return inside;
    }

    // Whether all of `word` is a whole number of at most `most` digits.
    static bool whole(const char *word, int most, bool may_be_negative, long &value) {
        const char *digit = word + (may_be_negative && *word == '-');
        int count = (int)strlen(digit);
        if (count < 1 || count > most || (int)strspn(digit, "0123456789") != count) return false;
        value = strtol(word, 0, 10);
        return true;
    }

    Board &board_;
    char line_[longest_request + 2], text_[longest_answer + 1], answer_[longest_answer + 8];
    int length_ = 0;
    long millivolts_[channel_count];
    volatile bool armed_ = false;
    volatile uint32_t written_ = 0;
    unsigned long expired_count_ = 0;
};

}  // namespace gelbot
