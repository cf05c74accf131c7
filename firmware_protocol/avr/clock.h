/* The device clock, and the light that blinks by it. */
#ifndef CLOCK_H
#define CLOCK_H

#include <stdint.h>

/* Of timer 1; its compare unit A belongs to the scan. */
#define TICKS_PER_US 2
#define TICKS_PER_S (1000000UL * TICKS_PER_US)

void clock_start(void);

/* Microseconds since boot, modulo 2^32. */
uint32_t clock_us(void);

/* The same where interrupts are off already, as in an interrupt. */
uint32_t clock_us_locked(void);

/* Blink for some seconds from now; 0 ends it. */
void identify(uint8_t seconds);

#endif
