// Reference firmware of the controller of web, trigger, lens and light, for any 32-bit board with the Arduino core.
//
// It speaks the line protocol described in vamgpu.hosts.protocols.controller. Nothing here waits: loop() looks at
// lease, interlock, pulses, steps and the line in turn, a few microseconds a turn.
//
// Wiring that must hold when this program does not: a pull-down resistor on every GATE pin, so that the light is off
// while the board starts, resets or hangs; the interlock switch in series with the light's supply as well as on its
// pin; and the board's watchdog on (WATCHDOG_START and WATCHDOG_FEED), which resets it, and so darkens it, when a turn
// of loop() does not end.

#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#ifndef WATCHDOG_START
#define WATCHDOG_START()
#define WATCHDOG_FEED()
#endif

// ---- what to set for a machine -------------------------------------------------------------------------------------
static const uint8_t CHANNELS = 2;
static const uint8_t GATE_PINS[CHANNELS] = {2, 3};
static const uint8_t DRIVE_PINS[CHANNELS] = {4, 5};  // analog or PWM outputs to the light's supply
static const uint8_t TRIGGER_PIN = 6;                // to the projector; one pulse a picture
static const uint8_t STEP_PIN = 7;
static const uint8_t DIRECTION_PIN = 8;
static const uint8_t INTERLOCK_PIN = 9;  // closed to ground while the enclosure is shut
static const uint32_t TRIGGER_US = 20;
static const uint32_t LENS_BAUD = 38400;
static const uint32_t LONGEST_LEASE_MS = 1000;
static const uint16_t CAPACITY = 256;
static const uint8_t LONGEST_LINE = 96;
#define HOST Serial
#define LENS Serial1

// ---- state ---------------------------------------------------------------------------------------------------------
struct Row {
  int64_t at;
  int32_t code;
  uint32_t delay_us;
  uint32_t on_us;
  uint8_t channels;
  bool has_code;
};

static Row rows[CAPACITY];
static uint16_t first_row, queued;
static int64_t next_row, total, shown, late_rows;
static bool armed, running, done, steps_mode, waiting, pulsing, triggering, closed = true;
static const char *fault = "none";
static uint8_t light, steady;
static int64_t lease_end = -1, started, wait_until, pulse_end, trigger_end;
static Row current;

static int64_t position;              // microsteps
static double speed, wanted, accel = 200000.0;  // microsteps per second, and per second squared
static double fraction;               // of the next microstep
static int64_t stepped;

static char line[LONGEST_LINE + 1];
static uint8_t length;
static bool overlong;
static char last_answer[LONGEST_LINE + 1];
static int32_t last_number = -1;

// ---- time: 64 bits of microseconds ---------------------------------------------------------------------------------
static int64_t now_us() {
  static uint32_t low, high;
  uint32_t t = micros();
  if (t < low) high++;
  low = t;
  return ((int64_t)high << 32) | t;
}

// ---- check sums ----------------------------------------------------------------------------------------------------
static uint16_t line_check(const char *text, size_t n) {
  uint16_t value = 0xFFFF;
  for (size_t i = 0; i < n; i++) {
    value ^= (uint16_t)(uint8_t)text[i] << 8;
    for (uint8_t bit = 0; bit < 8; bit++) value = value & 0x8000 ? (value << 1) ^ 0x1021 : value << 1;
  }
  return value;
}

static uint16_t lens_check(const uint8_t *data, size_t n) {
  uint16_t value = 0;
  for (size_t i = 0; i < n; i++) {
    value ^= data[i];
    for (uint8_t bit = 0; bit < 8; bit++) value = value & 1 ? (value >> 1) ^ 0xA001 : value >> 1;
  }
  return value;
}

// ---- text out ------------------------------------------------------------------------------------------------------
static void add(char *out, const char *text) { strncat(out, text, LONGEST_LINE - strlen(out)); }

static void add_number(char *out, int64_t value) {
  char digits[24];
  uint8_t i = sizeof digits;
  bool negative = value < 0;
  uint64_t rest = negative ? -(uint64_t)value : (uint64_t)value;
  digits[--i] = 0;
  do digits[--i] = '0' + rest % 10; while (rest /= 10);
  if (negative) digits[--i] = '-';
  add(out, digits + i);
}

static void send(char *out) {
  static const char HEX_DIGITS[] = "0123456789ABCDEF";
  uint16_t check = line_check(out, strlen(out));
  char tail[7] = {'*', HEX_DIGITS[check >> 12], HEX_DIGITS[check >> 8 & 15], HEX_DIGITS[check >> 4 & 15],
                  HEX_DIGITS[check & 15], '\n', 0};
  add(out, tail);
  HOST.write((const uint8_t *)out, strlen(out));
}

static void say(const char *text, int64_t value, bool has_value) {
  char out[LONGEST_LINE + 1] = "! ";
  add(out, text);
  if (has_value) {
    add(out, " ");
    add_number(out, value);
  }
  send(out);
}

// ---- light ---------------------------------------------------------------------------------------------------------
static void set_light(uint8_t channels) {
  for (uint8_t i = 0; i < CHANNELS; i++) digitalWrite(GATE_PINS[i], channels >> i & 1 ? HIGH : LOW);
  light = channels;
}

static void close_light(const char *reason, bool is_fault) {
  set_light(0);
  steady = 0;
  armed = running = waiting = pulsing = false;
  lease_end = -1;
  if (is_fault) fault = reason;
  char text[32] = "light off ";
  strncat(text, reason, 20);
  say(text, 0, false);
}

// ---- rows ----------------------------------------------------------------------------------------------------------
static bool reached(int64_t at, int64_t now) { return steps_mode ? position >= at : now >= started + at; }

static void finish() {
  if (running && total >= 0 && next_row >= total && !waiting) {
    running = false;
    done = true;
    say("done", shown, true);
  }
}

static void act_row(int64_t now) {
  current = rows[first_row];
  first_row = (first_row + 1) % CAPACITY;
  queued--;
  next_row++;
  if (current.has_code) {
    uint8_t frame[10] = {'P', 'w', 'D', 'A', (uint8_t)(current.code >> 8), (uint8_t)current.code, 0, 0, 0, 0};
    uint16_t check = lens_check(frame, 8);
    frame[8] = check & 255;
    frame[9] = check >> 8;
    LENS.write(frame, sizeof frame);
  }
  waiting = true;
  wait_until = (steps_mode ? now : started + current.at > now ? now : started + current.at) + current.delay_us;
}

static void fire(int64_t now) {
  waiting = false;
  if (pulsing) {
    pulsing = false;
    set_light(steady);
  }
  shown++;
  digitalWrite(TRIGGER_PIN, HIGH);
  triggering = true;
  trigger_end = now + TRIGGER_US;
  if (current.on_us && armed) {
    set_light(steady | current.channels);
    pulsing = true;
    pulse_end = now + current.on_us;
  } else {
    finish();
  }
}

static void play(int64_t now) {
  if (triggering && now >= trigger_end) {
    triggering = false;
    digitalWrite(TRIGGER_PIN, LOW);
  }
  if (pulsing && now >= pulse_end) {
    pulsing = false;
    set_light(steady);
    finish();
  }
  if (waiting && now >= wait_until) fire(now);
  if (running && queued && !waiting && reached(rows[first_row].at, now)) act_row(now);
}

// ---- web -----------------------------------------------------------------------------------------------------------
static void step_web(int64_t now) {
  double seconds = (now - stepped) * 1e-6;
  stepped = now;
  double change = accel * seconds;
  if (speed < wanted) speed = speed + change < wanted ? speed + change : wanted;
  if (speed > wanted) speed = speed - change > wanted ? speed - change : wanted;
  fraction += speed * seconds;
  while (fraction >= 1.0 || fraction <= -1.0) {
    bool up = fraction > 0;
    digitalWrite(DIRECTION_PIN, up ? HIGH : LOW);
    digitalWrite(STEP_PIN, HIGH);
    delayMicroseconds(2);
    digitalWrite(STEP_PIN, LOW);
    position += up ? 1 : -1;
    fraction -= up ? 1.0 : -1.0;
  }
}

// ---- commands ------------------------------------------------------------------------------------------------------
static void reset_rows() {
  queued = first_row = 0;
  next_row = 0;
  total = -1;
}

static const char *add_row(int64_t *n, uint8_t count, bool has_code, int64_t now) {
  if (count != 6) return "range";
  if (n[0] != next_row + queued) return "order";
  if (queued >= CAPACITY) return "full";
  if (n[1] < 0 || n[3] < 0 || n[4] < 0 || n[5] < 0 || n[5] >= 1 << CHANNELS) return "range";
  if (n[3] > 0x7FFFFFFF || n[4] > 0x7FFFFFFF || n[2] > 32767 || n[2] < -32767) return "range";
  bool passed = running && (steps_mode ? position > n[1] : now > started + n[1]);
  if (passed) late_rows++;
  Row row = {n[1], (int32_t)n[2], (uint32_t)n[3], passed ? 0 : (uint32_t)n[4], (uint8_t)n[5], has_code};
  rows[(first_row + queued) % CAPACITY] = row;
  queued++;
  return 0;
}

static void add_status(char *out, int64_t now) {
  const char *state = strcmp(fault, "none") ? "fault" : running ? "running" : done ? "done" : armed ? "armed" : "idle";
  int64_t lease = lease_end > now ? (lease_end - now) / 1000 : 0;
  int64_t rate = (int64_t)(speed * 1000 + (speed < 0 ? -0.5 : 0.5));
  int64_t numbers[10] = {next_row, shown, late_rows, CAPACITY - queued, position, rate, lease, light, armed, closed};
  add(out, state);
  for (uint8_t i = 0; i < 10; i++) {
    add(out, " ");
    add_number(out, numbers[i]);
  }
  add(out, " ");
  add(out, fault);
}

// Acts on a command; returns the reason of a refusal, or 0, with values of the answer in `values`.
static const char *command(const char *verb, char **words, uint8_t count, char *values, int64_t now) {
  int64_t n[6] = {0, 0, 0, 0, 0, 0};
  bool dash = false;
  bool text = !strcmp(verb, "mode");
  if (count > 6) return "range";
  for (uint8_t i = 0; i < count && !text; i++) {
    char *end = words[i];
    if (!strcmp(words[i], "-")) {
      dash = true;
    } else {
      n[i] = strtoll(words[i], &end, 10);
      if (*end || end == words[i]) return "range";
    }
  }
  if (!strcmp(verb, "hello")) {
    close_light("hello", false);
    reset_rows();
    shown = late_rows = 0;
    done = steps_mode = false;
    fault = "none";
    add(values, "vam-controller 1 ");
    add_number(values, CAPACITY);
    add(values, " ");
    add_number(values, LONGEST_LEASE_MS);
    add(values, " ");
    add_number(values, CHANNELS);
  } else if (!strcmp(verb, "lease")) {
    if (count != 1 || n[0] < 1 || n[0] > LONGEST_LEASE_MS) return "range";
    lease_end = now + n[0] * 1000;
  } else if (!strcmp(verb, "arm")) {
    if (!closed) return "interlock";
    if (lease_end <= now) return "lease";
    armed = true;
    fault = "none";
  } else if (!strcmp(verb, "disarm")) {
    close_light("disarm", false);
  } else if (!strcmp(verb, "power")) {
    if (count != 2 || n[0] < 0 || n[0] >= CHANNELS || n[1] < 0 || n[1] > 65535) return "range";
    analogWrite(DRIVE_PINS[n[0]], n[1]);
  } else if (!strcmp(verb, "light")) {
    if (n[0] && !armed) return "armed";
    if (count != 1 || n[0] < 0 || n[0] >= 1 << CHANNELS) return "range";
    steady = n[0];
    if (!pulsing || !steady) {
      pulsing = false;
      set_light(steady);
    }
  } else if (text) {
    if (running) return "state";
    if (count != 1 || (strcmp(words[0], "time") && strcmp(words[0], "steps"))) return "range";
    steps_mode = words[0][0] == 's';
  } else if (!strcmp(verb, "row")) {
    const char *refusal = add_row(n, count, !dash, now);
    if (refusal) return refusal;
    add_number(values, CAPACITY - queued);
    add(values, " ");
    add_number(values, n[0] + 1);
  } else if (!strcmp(verb, "end")) {
    if (count != 1) return "range";
    total = n[0];
  } else if (!strcmp(verb, "go")) {
    if (running) return "state";
    running = true;
    done = false;
    shown = late_rows = 0;
    started = now;
  } else if (!strcmp(verb, "move")) {
    if (count != 1) return "range";
    wanted = n[0] / 1000.0;
  } else if (!strcmp(verb, "ramp")) {
    if (count != 1 || n[0] < 1) return "range";
    accel = n[0];
  } else if (!strcmp(verb, "zero")) {
    if (running) return "state";
    position = 0;
    fraction = 0;
  } else if (!strcmp(verb, "stop")) {
    close_light("stop", false);
    reset_rows();
    wanted = 0;
  } else if (!strcmp(verb, "stat")) {
    add_status(values, now);
  } else {
    return "verb";
  }
  return 0;
}

static void complain() {
  char out[LONGEST_LINE + 1] = "? line";
  send(out);
}

static void read_line(int64_t now) {
  char *star = strrchr(line, '*');
  if (!star || strlen(star) != 5 || strtoul(star + 1, 0, 16) != line_check(line, star - line)) return complain();
  *star = 0;
  char *words[9];
  uint8_t count = 0;
  for (char *word = strtok(line, " "); word && count < 9; word = strtok(0, " ")) words[count++] = word;
  char *end = line;
  long number = count ? strtol(words[0], &end, 10) : -1;
  if (count < 2 || *end || number < 0) return complain();
  if (strcmp(words[1], "hello") && number == last_number) {
    HOST.write((const uint8_t *)last_answer, strlen(last_answer));
    return;
  }
  char values[LONGEST_LINE + 1] = "";
  const char *refusal = command(words[1], words + 2, count - 2, values, now);
  last_answer[0] = 0;
  add_number(last_answer, number);
  add(last_answer, refusal ? " no " : *values ? " ok " : " ok");
  add(last_answer, refusal ? refusal : values);
  send(last_answer);
  last_number = number;
}

static void listen(int64_t now) {
  while (HOST.available()) {
    char c = HOST.read();
    if (c == '\n') {
      line[length] = 0;
      if (overlong) complain();
      else if (length) read_line(now);
      length = 0;
      overlong = false;
      return;  // one line a turn, so that the light is never kept waiting
    }
    if (c == '\r') continue;
    if (length >= LONGEST_LINE) overlong = true;
    else line[length++] = c;
  }
}

void setup() {
  for (uint8_t i = 0; i < CHANNELS; i++) {
    digitalWrite(GATE_PINS[i], LOW);
    pinMode(GATE_PINS[i], OUTPUT);
    pinMode(DRIVE_PINS[i], OUTPUT);
  }
  set_light(0);
  pinMode(TRIGGER_PIN, OUTPUT);
  pinMode(STEP_PIN, OUTPUT);
  pinMode(DIRECTION_PIN, OUTPUT);
  pinMode(INTERLOCK_PIN, INPUT_PULLUP);
  analogWriteResolution(16);
  for (uint8_t i = 0; i < CHANNELS; i++) analogWrite(DRIVE_PINS[i], 65535);
  HOST.begin(115200);
  LENS.begin(LENS_BAUD);
  reset_rows();
  stepped = now_us();
  WATCHDOG_START();
}

void loop() {
  int64_t now = now_us();
  WATCHDOG_FEED();
  bool shut = digitalRead(INTERLOCK_PIN) == LOW;
  if (closed && !shut) {
    closed = false;
    close_light("interlock", true);
  }
  closed = shut;
  if ((light || armed) && lease_end >= 0 && now >= lease_end) close_light("lease", true);
  step_web(now);
  play(now);
  listen(now);
}
