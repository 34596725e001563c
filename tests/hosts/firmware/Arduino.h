// As much of the Arduino core as the sketch uses, on a board whose time a test sets.
#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>

enum { LOW, HIGH };
enum { INPUT, OUTPUT, INPUT_PULLUP };

uint32_t micros();
void delayMicroseconds(uint32_t us);
void pinMode(uint8_t pin, uint8_t mode);
void digitalWrite(uint8_t pin, uint8_t level);
int digitalRead(uint8_t pin);
void analogWrite(uint8_t pin, int value);
void analogWriteResolution(int bits);

// A serial port with a small buffer each way; like the real one, write() waits while its buffer is full.
class Port {
 public:
  explicit Port(int kind) : kind_(kind) {}
  void begin(uint32_t baud);
  int available() const { return (int)received_.size(); }
  int read();
  int availableForWrite();
  size_t write(const uint8_t *data, size_t size);
  void arrive(uint8_t byte) { received_.push_back(byte); }

 private:
  int kind_;
  double byte_us_ = 0;
  double last_left_ = 0;
  std::deque<uint8_t> received_;
  std::deque<double> leaving_;
};

extern Port Serial, Serial1;
