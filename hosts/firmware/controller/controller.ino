// Reference firmware of the controller of web, trigger, lens and light, for any 32-bit board with the Arduino core.
//
// It implements the line protocol described in PROTOCOL.md. Nothing here waits: loop() checks lease, interlock,
// encoder, steps, pulses and the line in turn, a few microseconds per turn, and gives the line no more bytes than it
// can take at once. Wiring that must be safe even if this program fails: a pull-down resistor on every GATE pin, which
// keeps the light off while the board starts, resets or hangs; the interlock switch in series with the light's supply
// as well as on its pin; and the board's watchdog on (WATCHDOG_START and WATCHDOG_FEED), which resets the board, and so
// turns the light off, when a turn of loop() does not end. Settings that differ from machine to machine are in
// settings.h.

#include "commands.h"

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
  for (uint8_t i = 0; i < LONGEST_LINE && HOST.available(); i++) {
    char c = HOST.read();
    if (c == '\n') {
      line[length] = 0;
      if (overlong) complain();
      else if (length) read_line(now);
      length = 0;
      overlong = false;
      return;  // at most one line per turn; the light never waits
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
  pinMode(ENCODER_A_PIN, INPUT_PULLUP);
  pinMode(ENCODER_B_PIN, INPUT_PULLUP);
  pinMode(INDEX_PIN, INPUT);
  phase = (digitalRead(ENCODER_A_PIN) == HIGH) << 1 | (digitalRead(ENCODER_B_PIN) == HIGH);
  mark_high = digitalRead(INDEX_PIN) == HIGH;
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
  watch(now);
  step_web(now);
  play(now);
  listen(now);
  hand_over();
}
