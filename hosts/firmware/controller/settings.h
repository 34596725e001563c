// Settings for a machine.
#pragma once

#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#ifndef WATCHDOG_START
#define WATCHDOG_START()
#define WATCHDOG_FEED()
#endif

static const uint8_t CHANNELS = 2;
static const uint8_t GATE_PINS[CHANNELS] = {2, 3};
static const uint8_t DRIVE_PINS[CHANNELS] = {4, 5};  // analog or PWM outputs to the light's supply
static const uint8_t TRIGGER_PIN = 6;                // to the projector; one pulse per frame
static const uint8_t STEP_PIN = 7;
static const uint8_t DIRECTION_PIN = 8;
static const uint8_t INTERLOCK_PIN = 9;  // closed to ground while the enclosure is shut
static const uint8_t ENCODER_A_PIN = 10;  // quadrature on the moved axis; A and B are read once per turn of loop() and
static const uint8_t ENCODER_B_PIN = 11;  // after each step; turns of loop() must therefore be shorter than a count
static const uint8_t INDEX_PIN = 12;      // high at the index mark; the mark must be longer than a step
static const int64_t LONGEST_RATIO = 1000000;  // of counts, marks and microsteps in a ratio
static const uint32_t TRIGGER_US = 20;
static const uint32_t TRIGGER_GAP_US = 50;  // least time between pulses, which keeps two from looking like one
static const uint32_t STEP_US = 2;           // a step pulse, and the pause before the next, as the motor's driver requires
static const uint8_t STEPS_A_TURN = 16;      // greatest part of loop(); the rest is made up in the next turns
static const int64_t FASTEST = 200000;       // microseconds or microsteps per second that steps, pauses and the rest of loop() allow
static const int64_t STEEPEST = 100000000;   // microsteps per second squared
static const int64_t RAMP = 200000;          // the same, until a host sets another
static const int64_t LONGEST_DEBT = 1000;    // microsteps; a web further behind stays behind, and its host sees it
static const uint32_t LENS_BAUD = 38400;
static const uint32_t LONGEST_LEASE_MS = 1000;
static const uint16_t CAPACITY = 256;
static const uint16_t OUTBOX = 512;  // bytes of waiting answers; answers that do not fit are dropped, and requested again
static const int64_t GREATEST = 1000000000000000;  // microseconds or microsteps: some thirty years
static const int64_t LONGEST_US = 0x7FFFFFFF;
static const uint8_t LONGEST_LINE = 160;

#define HOST Serial
#define LENS Serial1
