// A board of pins, ports and simulated time around the sketch, as a library: each turn of loop() takes TURN_US.
#include "Arduino.h"

#include <vector>

static const int64_t TURN_US = 10;
static const int PORT_BUFFER = 64;
enum { PIN = 0, ANALOG = 1000, HOST_BYTE = 2000, LENS_BYTE = 2001 };

struct Event {
  int64_t at_us;
  int32_t kind;
  int32_t value;
};

static int64_t time_us;
static uint32_t first_micros;
static int levels[64];
static int64_t shaft;  // microsteps that the motor went
static bool stalled;
static const int64_t COUNTS = 1, STEPS = 8, MARK = 500, ROUND = 3200, WIDTH = 64;
static std::vector<Event> events;
Port Serial(HOST_BYTE), Serial1(LENS_BYTE);

uint32_t micros() { return first_micros + (uint32_t)time_us; }
void delayMicroseconds(uint32_t us) { time_us += us; }
void pinMode(uint8_t, uint8_t) {}
void analogWriteResolution(int) {}
int digitalRead(uint8_t pin);
void analogWrite(uint8_t pin, int value) { events.push_back({time_us, ANALOG + pin, value}); }

static void turn_shaft(uint8_t pin, uint8_t level);

void digitalWrite(uint8_t pin, uint8_t level) {
  if (levels[pin] == level) return;
  levels[pin] = level;
  events.push_back({time_us, PIN + pin, level});
  turn_shaft(pin, level);
}

void Port::begin(uint32_t baud) { byte_us_ = 1e7 / baud; }

int Port::read() {
  if (received_.empty()) return -1;
  int byte = received_.front();
  received_.pop_front();
  return byte;
}

int Port::availableForWrite() {
  while (!leaving_.empty() && leaving_.front() <= time_us) leaving_.pop_front();
  return PORT_BUFFER - (int)leaving_.size();
}

size_t Port::write(const uint8_t *data, size_t size) {
  for (size_t i = 0; i < size; i++) {
    while (!availableForWrite()) time_us++;
    last_left_ = (last_left_ > time_us ? last_left_ : time_us) + byte_us_;
    leaving_.push_back(last_left_);
    events.push_back({(int64_t)last_left_ + 1, kind_, data[i]});
  }
  return size;
}

#include "controller.ino"

static int64_t floor_div(int64_t a, int64_t b) { return a >= 0 ? a / b : -((b - 1 - a) / b); }

static void turn_shaft(uint8_t pin, uint8_t level) {
  if (pin == STEP_PIN && level == HIGH && !stalled) shaft += levels[DIRECTION_PIN] ? 1 : -1;
}

int digitalRead(uint8_t pin) {
  int64_t count = floor_div(shaft * COUNTS, STEPS) & 3;
  if (pin == ENCODER_A_PIN) return count == 2 || count == 3;
  if (pin == ENCODER_B_PIN) return count == 1 || count == 2;
  if (pin == INDEX_PIN) return shaft - MARK - ROUND * floor_div(shaft - MARK, ROUND) < WIDTH;
  return levels[pin];
}

extern "C" {
void board_stall() { stalled = true; }

void board_start(uint32_t micros_at_start) {
  first_micros = micros_at_start;
  setup();
}

void board_run(int64_t until_us) {
  while (time_us + TURN_US <= until_us) {
    time_us += TURN_US;
    loop();
  }
}

void board_receive(const uint8_t *data, int size) {
  for (int i = 0; i < size; i++) Serial.arrive(data[i]);
}

void board_interlock(int open) { levels[INTERLOCK_PIN] = open ? HIGH : LOW; }

int board_events(Event *out, int most) {
  int taken = most < (int)events.size() ? most : (int)events.size();
  for (int i = 0; i < taken; i++) out[i] = events[i];
  events.erase(events.begin(), events.begin() + taken);
  return taken;
}
}
