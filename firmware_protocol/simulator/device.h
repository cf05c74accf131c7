/* A simulated ATmega328P at 16 MHz and 5 V with a firmware, and the queues of bytes between it and the world outside. */
#ifndef DEVICE_H
#define DEVICE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define QUEUE_BYTES 65536

/* What waits on its way. What does not fit is lost, as on a line. */
typedef struct {
    uint8_t bytes[QUEUE_BYTES];
    size_t begin, end;
} queue;

extern queue to_device, from_device;

void queue_put(queue *to, uint8_t byte);

/* Load a firmware, switch on. */
void device_start(const char *elf_path);

/* As by the reset button. */
void device_reset(void);

/* Run for a simulated millisecond; false if the firmware has come to an end, as none should. */
bool device_run(void);

/* Simulated seconds since the start. */
double device_s(void);

/* Set the voltage at an analogue input. */
void device_set_voltage(int channel, unsigned millivolts);

/* How often the light at PB5 has changed. */
unsigned device_light_changes(void);

/* What the device has set its line to; 0 if nothing yet. */
unsigned device_baud(void);

void device_load_eeprom(const char *path); /* nothing happens if there is no such file */
void device_save_eeprom(const char *path);

/* Say what cannot be used, and why if errno knows; exit. */
_Noreturn void fail(const char *what);

#endif
