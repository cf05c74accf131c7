#include "clock.h"

#include <avr/interrupt.h>
#include <avr/io.h>
#include <stdbool.h>
#include <util/atomic.h>

#define LIGHT _BV(PB5)     /* the light of an Arduino Uno or Nano */
#define OVERFLOW_US 32768  /* 65536 ticks of half a microsecond */
#define BLINK_OVERFLOWS 4  /* on or off for 131 ms */

/* A test sets this so that the clock wraps soon. */
#ifndef CLOCK_BEGINS_US
#define CLOCK_BEGINS_US 0
#endif

static volatile uint32_t overflowed_us = CLOCK_BEGINS_US;
static volatile uint16_t identify_overflows;

void clock_start(void) {
    DDRB |= LIGHT;
    TCCR1A = 0;
    TCCR1B = _BV(CS11); /* 16 MHz / 8, free-running */
    TIMSK1 |= _BV(TOIE1);
}

uint32_t clock_us_locked(void) {
    uint16_t ticks = TCNT1;
    uint32_t us = overflowed_us;
    /* The counter may just have wrapped while its interrupt is still pending. */
    bool is_behind = (TIFR1 & _BV(TOV1)) && ticks < 0x8000;
    if (is_behind) us += OVERFLOW_US;
    return us + ticks / TICKS_PER_US;
}

uint32_t clock_us(void) {
    uint32_t us;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { us = clock_us_locked(); }
    return us;
}

void identify(uint8_t seconds) {
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        identify_overflows = seconds * 61U / 2; /* 30.5 overflows per second */
        PORTB &= (uint8_t)~LIGHT;
    }
}

ISR(TIMER1_OVF_vect) {
    overflowed_us += OVERFLOW_US;
    uint16_t left = identify_overflows;
    if (left == 0) return;
    identify_overflows = --left;
    if (left == 0) {
        PORTB &= (uint8_t)~LIGHT;
    } else if (left % BLINK_OVERFLOWS == 0) {
        PINB = LIGHT; /* writing a one here toggles the pin */
    }
}
