/* A simulated ATmega328P at 16 MHz and 5 V with its firmware, and the byte queues to and from its serial line. */
#ifndef DEVICE_H
#define DEVICE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define QUEUE_BYTES 65536

/* Bytes in transit. Bytes that do not fit are lost, as on a real line. */
typedef struct {
    uint8_t bytes[QUEUE_BYTES];
    size_t begin, end;
} queue;

extern queue to_device, from_device;

void queue_put(queue *to, uint8_t byte);

/* Load a firmware and switch on. Exits with a message if that fails. */
void device_start(const char *elf_path);

/* Press the reset button. */
void device_reset(void);

/* Run for one simulated millisecond; false if the firmware crashed or ended. */
bool device_run(void);

/* Simulated seconds since the start. */
double device_s(void);

/* Set the voltage at an analogue input, ADC0 and up. */
void device_set_voltage(int channel, unsigned millivolts);

/* How often the light at PB5 has changed. */
unsigned device_light_changes(void);

/* The baud rate that the firmware has set; 0 before it has set one. */
unsigned device_baud(void);

/* Fill the EEPROM from a file; a missing file leaves it empty. */
void device_load_eeprom(const char *path);

/* Write the EEPROM to a file. Exits with a message if that fails. */
void device_save_eeprom(const char *path);

#endif
