// The line to the host: check sums, outgoing lines, and their buffer.
#pragma once

#include "settings.h"

static char line[LONGEST_LINE + 1];
static uint8_t length;
static bool overlong;
static char last_answer[LONGEST_LINE + 1];
static int32_t last_number = -1;
static uint16_t last_check;
static uint8_t outbox[OUTBOX];
static uint16_t outbox_first, outbox_used;

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

// A port with a full buffer would make the light wait; therefore lines go through a separate buffer.
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
