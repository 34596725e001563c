// The commands of the host.
#pragma once

#include "machine.h"

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
  int64_t room = CAPACITY - queued;
  int64_t senses = (encoder.counts ? 1 : 0) | (marking.counts ? 2 : 0) | (home_number ? 4 : 0) | (astray ? 8 : 0);
  int64_t numbers[15] = {next_row, shown, late_rows, room, position, rate, zero, play_number,
                         lease, light, armed, closed, senses, measured(), marks};
  add(out, state);
  for (uint8_t i = 0; i < 15; i++) {
    add(out, " ");
    add_number(out, numbers[i]);
  }
  add(out, " ");
  add(out, fault);
}

static void answer_hello(char *values) {
  close_light("hello", false);
  reset_rows();
  done = steps_mode = false;
  accel = RAMP;
  fault = "none";
  encoder = marking = {0, 1, 0};
  home_number = 0;
  mark_known = astray = false;
  add(values, "vam-controller 3 ");
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
    if (!encoder_agrees()) return "stall";
    if (astray) return "index";
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

// The commands of the encoder and the mark; the reason of a refusal, or 0.
static const char *command_senses(const char *verb, const int64_t *n) {
  if (!strcmp(verb, "home")) {
    if (running || !marking.counts) return "state";
    if (n[0] < 1 || n[0] > 65535 || n[1] < 1 || n[1] > FASTEST * 1000) return "range";
    home_number = n[0];
    wanted = n[1] / 1000.0;
    return 0;
  }
  bool marked = !strcmp(verb, "index");
  if (!marked && strcmp(verb, "encoder")) return "verb";
  if (running) return "state";
  int64_t size = n[0] < 0 ? -n[0] : n[0];
  if (size > LONGEST_RATIO || n[1] < 1 || n[1] > LONGEST_RATIO || (marked && n[0] < 0)) return "range";
  if (n[0] && (n[2] < 1 || n[2] > LONGEST_RATIO || (!marked && n[2] * size < 2 * n[1]))) return "range";
  (marked ? marking : encoder) = {n[0], n[1], n[2]};
  mark_known = astray = false;
  measured_before = position;
  counts_before = counts;
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
    if (n[0] < 1 || n[0] > 65535) return "range";
    running = true;
    done = false;
    shown = late_rows = 0;
    play_number = n[0];
    started = earliest = now;
  } else if (!strcmp(verb, "move")) {
    if (n[0] > FASTEST * 1000 || n[0] < -FASTEST * 1000) return "range";
    home_number = 0;
    wanted = n[0] / 1000.0;
  } else if (!strcmp(verb, "ramp")) {
    if (n[0] < 1 || n[0] > STEEPEST) return "range";
    accel = n[0];
  } else if (!strcmp(verb, "zero")) {
    if (running) return "state";
    if (n[0] < 1 || n[0] > 65535) return "range";
    zero = n[0];
    call_position(0);
  } else if (!strcmp(verb, "stop")) {
    close_light("stop", false);
    reset_rows();
    wanted = home_number = 0;
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
                             {"light", 1}, {"mode", 1},  {"row", 6},   {"end", 1},    {"go", 1},
                             {"move", 1},  {"ramp", 1},  {"zero", 1},  {"stop", 0},   {"stat", 0},
                             {"encoder", 3}, {"index", 3}, {"home", 2}};

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
  if (refusal && !strcmp(refusal, "verb")) refusal = command_rows(name, n, dash, values, now);
  return refusal && !strcmp(refusal, "verb") ? command_senses(name, n) : refusal;
}
