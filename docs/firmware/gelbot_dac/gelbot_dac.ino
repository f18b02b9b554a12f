// A 16-channel supply for gelbot: an RP2040 board (arduino-pico core) and an LTC2668-16, which gives -10 V to 10 V.
//
// Never tried on a board: the protocol in gelbot_device.h is tested, pins and converter are from the data sheet. Watch
// every output with a voltmeter before a robot is connected.
//
// Hardware: the MSP pins of the LTC2668 strapped for the range -10 V to 10 V with reset to mid-scale, so that a reset
// means 0 V. A pull-down of 10 kOhm at its CLR pin: while the board has no power or starts, all outputs are at 0 V.
// An output of the converter gives a few milliamperes: each electrode has a power amplifier behind it.
#include <SPI.h>

#include "gelbot_device.h"

const int pin_select = 17, pin_clear = 20;  // CS/LD and CLR of the LTC2668
const SPISettings spi_settings(20000000, MSBFIRST, SPI_MODE0);

// The converter's commands: write a code into the register of one channel; update all outputs from the registers.
const uint8_t write_code = 0x00, update_all = 0x90;

void transfer(uint8_t command, uint16_t code) {
    digitalWrite(pin_select, LOW);
    SPI.transfer(command);
    SPI.transfer16(code);
    digitalWrite(pin_select, HIGH);
}

volatile bool cleared = true;  // CLR is low: the outputs are at 0 V whatever the registers say

struct Outputs : gelbot::Board {
    void apply(const long *millivolts) override {
        // The watchdog's interrupt does not come between: what is to be applied was written down as new before.
        digitalWrite(pin_clear, HIGH);  // cleared outputs stay at 0 V until the update
        cleared = false;
        SPI.beginTransaction(spi_settings);
        // The registers first; the outputs change together at the last command.
        for (int i = 0; i < gelbot::channel_count; ++i) {
            long code = ((millivolts[i] + 10000) * 65536 + 10000) / 20000;
            transfer(write_code | i, (uint16_t)(code > 65535 ? 65535 : code));
        }
        transfer(update_all, 0);
        SPI.endTransaction();
    }
    bool measure(long *) override { return false; }  // with shunts and a converter: fill in [uA], and answer true
};

Outputs outputs;
gelbot::Device *device = nullptr;

// Every millisecond, whatever the loop does: outputs to zero by a pin, without a word over SPI.
bool watchdog(repeating_timer_t *) {
    if (device && device->armed() && millis() - device->written() >= gelbot::watchdog_ms && !cleared) {
        digitalWrite(pin_clear, LOW);
        cleared = true;
    }
    return true;
}

repeating_timer_t timer;

void setup() {
    pinMode(pin_clear, OUTPUT);
    digitalWrite(pin_clear, LOW);
    pinMode(pin_select, OUTPUT);
    digitalWrite(pin_select, HIGH);
    SPI.begin();
    Serial.begin(115200);
    static gelbot::Device the_device(outputs);  // lets go of CLR, and sets all outputs to 0 V
    device = &the_device;
    add_repeating_timer_ms(-1, watchdog, nullptr, &timer);
    rp2040.wdt_begin(1000);  // should even the interrupts stop: the chip starts anew, and CLR is low
}

void loop() {
    rp2040.wdt_reset();
    device->expire(millis());
    while (Serial.available()) Serial.print(device->take((char)Serial.read(), millis()));
}
