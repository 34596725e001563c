// Independent actions of the machine: light, rows and web.
#pragma once

#include "line.h"

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
static int64_t next_row, total, shown, late_rows, play_number;
static bool armed, running, done, steps_mode, waiting, pulsing, triggering, closed = true;
static const char *fault = "none";
static uint8_t light, steady;
static int64_t lease_end = -1, started, earliest, wait_until, pulse_end, trigger_end, fired = -1000;
static Row current;

static int64_t position, zero;        // microsteps, and the number of position 0
static double speed, wanted, accel = RAMP;  // microsteps per second, and per second squared
static double fraction;               // remaining microsteps
static int64_t stepped;

struct Ratio {                        // ratio of counts or marks to microsteps; none with 0 counts
  int64_t counts, steps, limit;       // limit: the greatest error [microsteps]
};

static Ratio encoder, marking;
static int64_t counts, counts_before, measured_before;  // of the encoder, and its position when it was last set
static int64_t marks, marks_since, mark_first;          // marks passed; since the first one, and the position of that
static int64_t home_number;                             // number of the zero that the next mark becomes; 0: none
static bool mark_known, mark_high, astray;
static uint8_t phase;

// ---- time: 64 bits of microseconds ---------------------------------------------------------------------------------
static int64_t now_us() {
  static uint32_t low, high;
  uint32_t t = micros();
  if (t < low) high++;
  low = t;
  return ((int64_t)high << 32) | t;
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
  wait_until = (steps_mode ? now : due > earliest ? due : earliest) + current.delay_us;  // a delay within a turn adds nothing
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

// ---- position of the motion: an encoder, and a recurring mark -------------------------------------------------------
static int64_t measured() {
  if (!encoder.counts) return 0;
  return measured_before + (counts - counts_before) * encoder.steps / encoder.counts;
}

// The encoder and the mark count as agreeing with the steps here.
static void call_position(int64_t there) {
  mark_first += there - position;
  position = measured_before = there;
  counts_before = counts;
  fraction = 0;
  astray = false;
}

static void not_there(const char *reason) {
  if (light || armed || running) close_light(reason, true);
}

static bool encoder_agrees() {
  int64_t error = position - measured();
  return !encoder.counts || (error <= encoder.limit && -error <= encoder.limit);
}

static int64_t next_mark() { return mark_first + (marks_since + 1) * marking.steps / marking.counts; }

static void lose_mark() {
  astray = true;
  mark_known = false;
  not_there("index");
}

static void pass_mark() {
  marks++;
  if (home_number) {
    zero = home_number;
    home_number = 0;
    wanted = 0;
    call_position(0);
    mark_known = false;
    say("home", zero, true);
  }
  if (!mark_known) {
    mark_known = true;
    mark_first = position;
    marks_since = 0;
    return;
  }
  int64_t error = position - next_mark();
  marks_since++;
  if (error > marking.limit || -error > marking.limit) lose_mark();
}

static void see_position() {
  static const int8_t MOVES[16] = {0, 1, -1, 0, -1, 0, 0, 1, 1, 0, 0, -1, 0, -1, 1, 0};
  uint8_t pins = (digitalRead(ENCODER_A_PIN) == HIGH) << 1 | (digitalRead(ENCODER_B_PIN) == HIGH);
  counts += MOVES[phase << 2 | pins];
  phase = pins;
  bool high = digitalRead(INDEX_PIN) == HIGH, rose = high && !mark_high;
  mark_high = high;
  if (speed < 0) mark_known = false;  // it is seen at its other end
  else if (marking.counts && rose) pass_mark();
  else if (marking.counts && mark_known && position > next_mark() + marking.limit) lose_mark();
  if (!encoder_agrees()) not_there("stall");
}

// ---- events that may close the light at any time --------------------------------------------------------------------
static void watch(int64_t now) {
  bool shut = digitalRead(INTERLOCK_PIN) == LOW;
  if (closed && !shut) {
    closed = false;
    close_light("interlock", true);
  }
  closed = shut;
  if ((light || armed) && lease_end >= 0 && now >= lease_end) close_light("lease", true);
  see_position();
}

// ---- web -----------------------------------------------------------------------------------------------------------
static void step(bool up) {
  digitalWrite(DIRECTION_PIN, up ? HIGH : LOW);
  digitalWrite(STEP_PIN, HIGH);
  delayMicroseconds(STEP_US);
  digitalWrite(STEP_PIN, LOW);
  position += up ? 1 : -1;
  fraction -= up ? 1.0 : -1.0;
}

static void step_web(int64_t now) {
  double seconds = (now - stepped) * 1e-6;
  stepped = now;
  double change = accel * seconds, before = speed;
  if (speed < wanted) speed = speed + change < wanted ? speed + change : wanted;
  else if (speed > wanted) speed = speed - change > wanted ? speed - change : wanted;
  fraction += (before + speed) / 2 * seconds;
  if (fraction > LONGEST_DEBT) fraction = LONGEST_DEBT;
  if (fraction < -LONGEST_DEBT) fraction = -LONGEST_DEBT;
  for (uint8_t i = 0; i < STEPS_A_TURN && (fraction >= 1.0 || fraction <= -1.0); i++) {
    if (i) delayMicroseconds(STEP_US);
    step(fraction > 0);
    watch(now_us());
  }
}
