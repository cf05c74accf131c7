/* The device clock, and the Identify light, which blinks on its interrupt. */
#ifndef CLOCK_H
#define CLOCK_H

#include <stdint.h>

/* Timer 1. Its compare unit A belongs to the scan. */
#define TICKS_PER_US 2
#define TICKS_PER_S (1000000UL * TICKS_PER_US)

void clock_start(void);

/* Microseconds since boot, modulo 2^32. */
uint32_t clock_us(void);

/* The same, for callers that have already disabled interrupts. */
uint32_t clock_us_locked(void);

/* Blink for this long from now; 0 stops blinking. */
void identify(uint8_t seconds);

#endif
