// Reference firmware of the controller of web, trigger, lens and light, for any 32-bit board with the Arduino core.
//
// It speaks the line protocol described in vamgpu.hosts.protocols.controller. Nothing here waits: loop() looks at
// lease, interlock, steps, pulses and the line in turn, a few microseconds a turn, and hands the line no more bytes
// than it takes at once.
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
static const uint32_t TRIGGER_GAP_US = 50;  // from pulse to pulse at least, so that two never look like one
static const uint32_t LENS_BAUD = 38400;
static const uint32_t LONGEST_LEASE_MS = 1000;
static const uint16_t CAPACITY = 256;
static const uint16_t OUTBOX = 512;  // bytes of answers on their way; what does not fit is dropped, and asked for again
static const int64_t GREATEST = 1000000000000000;  // microseconds or microsteps: some thirty years
static const int64_t LONGEST_US = 0x7FFFFFFF;
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
static int64_t lease_end = -1, started, earliest, wait_until, pulse_end, trigger_end, fired = -1000;
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
static uint16_t last_check;
static uint8_t outbox[OUTBOX];
static uint16_t outbox_first, outbox_used;

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

static void write_hex(char *out, uint16_t value) {
  for (uint8_t i = 0; i < 4; i++) out[i] = "0123456789ABCDEF"[value >> (12 - 4 * i) & 15];
}

// A port whose buffer is full would keep the light waiting, so lines go through a buffer of this program's own.
static void post(const char *text) {
  uint16_t size = strlen(text);
  if (outbox_used + size > OUTBOX) return;
  for (uint16_t i = 0; i < size; i++) outbox[(outbox_first + outbox_used + i) % OUTBOX] = text[i];
  outbox_used += size;
}

static void hand_over() {
  int room = outbox_used ? HOST.availableForWrite() : 0;
  while (room-- > 0 && outbox_used) {
    HOST.write(&outbox[outbox_first], 1);
    outbox_first = (outbox_first + 1) % OUTBOX;
    outbox_used--;
  }
}

static void send(char *out) {
  char tail[7] = "*0000\n";
  write_hex(tail + 1, line_check(out, strlen(out)));
  add(out, tail);
  post(out);
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

static bool all_acted() { return total >= 0 && next_row >= total; }

static void finish() {
  if (running && all_acted() && !waiting && !pulsing) {
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
  int64_t due = started + current.at;
  wait_until = (steps_mode ? now : due > earliest ? due : earliest) + current.delay_us;  // a turn's delay adds nothing
  if (wait_until < fired + TRIGGER_GAP_US) wait_until = fired + TRIGGER_GAP_US;
}

static void fire(int64_t now) {
  waiting = false;
  fired = earliest = wait_until;
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
  }
  if (waiting && now >= wait_until) fire(now);
  if (running && queued && !waiting && !all_acted() && reached(rows[first_row].at, now)) act_row(now);
  finish();
}

// ---- web -----------------------------------------------------------------------------------------------------------
static void step_web(int64_t now) {
  double seconds = (now - stepped) * 1e-6;
  stepped = now;
  double change = accel * seconds, before = speed;
  if (speed < wanted) speed = speed + change < wanted ? speed + change : wanted;
  else if (speed > wanted) speed = speed - change > wanted ? speed - change : wanted;
  fraction += (before + speed) / 2 * seconds;
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

static const char *add_row(const int64_t *n, bool has_code, int64_t now) {
  if (n[0] != next_row + queued) return "order";
  if (queued >= CAPACITY) return "full";
  if (n[1] < 0 || n[3] < 0 || n[4] < 0 || n[5] < 0 || n[5] >= 1 << CHANNELS) return "range";
  if (n[1] > GREATEST || n[3] > LONGEST_US || n[4] > LONGEST_US || n[2] > 32767 || n[2] < -32767) return "range";
  bool passed = running && (steps_mode ? position > n[1] : now > started + n[1]);
  if (passed) late_rows++;
  if (!queued && !waiting) earliest = now;
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

static void answer_hello(char *values) {
  close_light("hello", false);
  reset_rows();
  shown = late_rows = 0;
  done = steps_mode = false;
  fault = "none";
  add(values, "vam-controller 1 ");
  int64_t numbers[3] = {CAPACITY, LONGEST_LEASE_MS, CHANNELS};
  for (uint8_t i = 0; i < 3; i++) {
    if (i) add(values, " ");
    add_number(values, numbers[i]);
  }
}

// The commands of light; the reason of a refusal, or 0.
static const char *command_light(const char *verb, const int64_t *n, int64_t now) {
  if (!strcmp(verb, "lease")) {
    if (n[0] < 1 || n[0] > LONGEST_LEASE_MS) return "range";
    lease_end = now + n[0] * 1000;
  } else if (!strcmp(verb, "arm")) {
    if (!closed) return "interlock";
    if (lease_end <= now) return "lease";
    armed = true;
    fault = "none";
  } else if (!strcmp(verb, "disarm")) {
    close_light("disarm", false);
  } else if (!strcmp(verb, "power")) {
    if (n[0] < 0 || n[0] >= CHANNELS || n[1] < 0 || n[1] > 65535) return "range";
    analogWrite(DRIVE_PINS[n[0]], n[1]);
  } else if (!strcmp(verb, "light")) {
    if (n[0] && !armed) return "armed";
    if (n[0] < 0 || n[0] >= 1 << CHANNELS) return "range";
    steady = n[0];
    if (!pulsing || !steady) {
      pulsing = false;
      set_light(steady);
    }
  } else {
    return "verb";
  }
  return 0;
}

// The commands of rows and web, with values of the answer in `values`; the reason of a refusal, or 0.
static const char *command_rows(const char *verb, const int64_t *n, bool dash, char *values, int64_t now) {
  if (!strcmp(verb, "row")) {
    const char *refusal = add_row(n, !dash, now);
    if (refusal) return refusal;
    add_number(values, CAPACITY - queued);
    add(values, " ");
    add_number(values, n[0] + 1);
  } else if (!strcmp(verb, "end")) {
    if (n[0] < 0) return "range";
    total = n[0];
  } else if (!strcmp(verb, "go")) {
    if (running) return "state";
    running = true;
    done = false;
    shown = late_rows = 0;
    started = earliest = now;
  } else if (!strcmp(verb, "move")) {
    wanted = n[0] / 1000.0;
  } else if (!strcmp(verb, "ramp")) {
    if (n[0] < 1) return "range";
    accel = n[0];
  } else if (!strcmp(verb, "zero")) {
    if (running) return "state";
    position = 0;
    fraction = 0;
  } else if (!strcmp(verb, "stop")) {
    close_light("stop", false);
    reset_rows();
    wanted = 0;
  } else {
    return "verb";
  }
  return 0;
}

static const char *set_mode(const char *word) {
  if (running) return "state";
  if (strcmp(word, "time") && strcmp(word, "steps")) return "range";
  steps_mode = word[0] == 's';
  return 0;
}

struct Verb {
  const char *name;
  uint8_t words;
};

static const Verb VERBS[] = {{"hello", 0}, {"lease", 1}, {"arm", 0},   {"disarm", 0}, {"power", 2},
                             {"light", 1}, {"mode", 1},  {"row", 6},   {"end", 1},    {"go", 0},
                             {"move", 1},  {"ramp", 1},  {"zero", 0},  {"stop", 0},   {"stat", 0}};

static const Verb *find_verb(const char *name) {
  for (const Verb &verb : VERBS)
    if (!strcmp(verb.name, name)) return &verb;
  return 0;
}

// Reads a whole number of at most `longest` digits.
static bool read_number(const char *word, uint8_t longest, int64_t *value) {
  bool negative = *word == '-';
  if (negative) word++;
  size_t size = strlen(word);
  if (size < 1 || size > longest) return false;
  *value = 0;
  for (; *word; word++) {
    if (*word < '0' || *word > '9') return false;
    *value = *value * 10 + (*word - '0');
  }
  if (negative) *value = -*value;
  return true;
}

// Acts on a command; returns the reason of a refusal, or 0, with values of the answer in `values`.
static const char *command(const char *name, char **words, uint8_t count, char *values, int64_t now) {
  const Verb *verb = find_verb(name);
  if (!verb) return "verb";
  if (count != verb->words) return "range";
  if (!strcmp(name, "mode")) return set_mode(words[0]);
  bool row = !strcmp(name, "row");
  bool dash = row && !strcmp(words[2], "-");
  int64_t n[6] = {0, 0, 0, 0, 0, 0};
  for (uint8_t i = 0; i < count; i++)
    if (!(dash && i == 2) && !read_number(words[i], 18, &n[i])) return "range";
  if (!strcmp(name, "hello")) {
    answer_hello(values);
    return 0;
  }
  if (!strcmp(name, "stat")) {
    add_status(values, now);
    return 0;
  }
  const char *refusal = command_light(name, n, now);
  return refusal && !strcmp(refusal, "verb") ? command_rows(name, n, dash, values, now) : refusal;
}

static void complain() {
  char out[LONGEST_LINE + 1] = "? line";
  send(out);
}

static void read_line(int64_t now) {
  char *star = strrchr(line, '*'), wanted_check[5] = "0000";
  if (!star) return complain();
  uint16_t check = line_check(line, star - line);
  write_hex(wanted_check, check);
  if (strcmp(star + 1, wanted_check)) return complain();
  *star = 0;
  char *words[9];
  uint8_t count = 0;
  for (char *word = strtok(line, " "); word && count < 9; word = strtok(0, " ")) words[count++] = word;
  int64_t number = 0;
  if (count < 2 || *words[0] == '-' || !read_number(words[0], 5, &number)) return complain();
  bool again = number == last_number && check == last_check;
  if (again && strcmp(words[1], "hello") && strcmp(words[1], "stat")) return post(last_answer);
  char values[LONGEST_LINE + 1] = "";
  const char *refusal = command(words[1], words + 2, count - 2, values, now);
  last_answer[0] = 0;
  add_number(last_answer, number);
  add(last_answer, refusal ? " no " : *values ? " ok " : " ok");
  add(last_answer, refusal ? refusal : values);
  send(last_answer);
  last_number = number;
  last_check = check;
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
  hand_over();
}
