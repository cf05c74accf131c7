/* The simulated chip. Only this file uses simavr. */
#include "device.h"
#include "fail.h"

#include <errno.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include <avr_adc.h>
#include <avr_eeprom.h>
#include <avr_ioport.h>
#include <avr_uart.h>
#include <sim_avr.h>
#include <sim_elf.h>
#include <sim_time.h>

#define FREQUENCY 16000000
#define SUPPLY_MV 5000
#define EEPROM_BYTES 1024
#define BYTE_US 10 /* on the line, at 1 000 000 baud */

queue to_device, from_device;

static avr_t *avr;
static avr_irq_t *uart_input;
static avr_uart_t *uart;
static avr_cycle_count_t byte_cycles; /* cycles per byte, corrected */
static bool device_is_full = true;    /* until the firmware switches its receiver on */
static unsigned light_changes;

void queue_put(queue *to, uint8_t byte) {
    if (to->begin == to->end) to->begin = to->end = 0;
    if (to->end < QUEUE_BYTES) to->bytes[to->end++] = byte;
}

static void on_sent(avr_irq_t *irq, uint32_t value, void *param) {
    (void)irq, (void)param;
    queue_put(&from_device, (uint8_t)value);
}

static void on_has_room(avr_irq_t *irq, uint32_t value, void *param) {
    (void)irq, (void)param;
    if (value) device_is_full = false;
}

static void on_is_full(avr_irq_t *irq, uint32_t value, void *param) {
    (void)irq, (void)param;
    if (value) device_is_full = true;
}

static void on_light(avr_irq_t *irq, uint32_t value, void *param) {
    (void)param;
    if (irq->value != value) light_changes++;
}

/* simavr counts eleven bits per byte. 8N1 has ten: it has no parity bit. */
static void correct_byte_time(void) {
    if (uart->cycles_per_byte == byte_cycles) return;
    byte_cycles = uart->cycles_per_byte = uart->cycles_per_byte * 10 / 11;
}

/* Called once per byte time: hands the device its next byte if the simulated receiver has room. */
static avr_cycle_count_t feed(avr_t *of, avr_cycle_count_t when, void *param) {
    (void)param;
    correct_byte_time();
    if (!device_is_full && to_device.begin < to_device.end) avr_raise_irq(uart_input, to_device.bytes[to_device.begin++]);
    return when + avr_usec_to_cycles(of, BYTE_US);
}

static avr_uart_t *find_uart(void) {
    for (avr_io_t *io = avr->io_port; io != NULL; io = io->next) {
        if (strcmp(io->kind, "uart") == 0) return (avr_uart_t *)io;
    }
    fail("simavr's UART");
}

/* Replace simavr's own pseudo-terminal, which loses bytes at this rate, and switch its console off. */
static void connect_uart(void) {
    uint32_t flags = 0;
    avr_ioctl(avr, AVR_IOCTL_UART_GET_FLAGS('0'), &flags);
    flags &= ~(uint32_t)(AVR_UART_FLAG_STDIO | AVR_UART_FLAG_POLL_SLEEP);
    avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
    const uint32_t irqs = AVR_IOCTL_UART_GETIRQ('0');
    uart = find_uart();
    uart_input = avr_io_getirq(avr, irqs, UART_IRQ_INPUT);
    avr_irq_register_notify(avr_io_getirq(avr, irqs, UART_IRQ_OUTPUT), on_sent, NULL);
    avr_irq_register_notify(avr_io_getirq(avr, irqs, UART_IRQ_OUT_XON), on_has_room, NULL);
    avr_irq_register_notify(avr_io_getirq(avr, irqs, UART_IRQ_OUT_XOFF), on_is_full, NULL);
}

/* Print errors only, to standard error. By default simavr prints what it loads to standard output, which is the board's. */
static void log_errors(avr_t *of, const int level, const char *format, va_list values) {
    (void)of;
    if (level <= LOG_ERROR) vfprintf(stderr, format, values);
}

void device_start(const char *elf_path) {
    elf_firmware_t firmware = {0};
    avr_global_logger_set(log_errors);
    errno = 0;
    if (elf_read_firmware(elf_path, &firmware) != 0) fail(elf_path);
    avr = avr_make_mcu_by_name("atmega328p");
    if (avr == NULL || avr_init(avr) != 0) fail("simavr's atmega328p");
    firmware.frequency = FREQUENCY;
    firmware.vcc = firmware.avcc = firmware.aref = SUPPLY_MV;
    avr_load_firmware(avr, &firmware);
    connect_uart();
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('B'), 5), on_light, NULL);
}

void device_reset(void) {
    device_is_full = true;
    avr_reset(avr);
}

bool device_run(void) {
    /* Every reset, including one by the watchdog, removes all simavr timers. */
    if (!avr_cycle_timer_status(avr, feed, NULL)) avr_cycle_timer_register_usec(avr, BYTE_US, feed, NULL);
    for (avr_cycle_count_t end = avr->cycle + FREQUENCY / 1000; avr->cycle < end;) {
        int state = avr_run(avr);
        if (state == cpu_Done || state == cpu_Crashed) return false;
    }
    return true;
}

double device_s(void) { return (double)avr->cycle / FREQUENCY; }

void device_set_voltage(int channel, unsigned millivolts) {
    avr_raise_irq(avr_io_getirq(avr, AVR_IOCTL_ADC_GETIRQ, channel), millivolts);
}

unsigned device_light_changes(void) { return light_changes; }

unsigned device_baud(void) { return byte_cycles ? (unsigned)(10 * FREQUENCY / byte_cycles) : 0; }

void device_load_eeprom(const char *path) {
    uint8_t content[EEPROM_BYTES];
    FILE *file = fopen(path, "rb");
    if (file == NULL) return;
    avr_eeprom_desc_t all = {.ee = content, .size = (uint32_t)fread(content, 1, sizeof content, file)};
    avr_ioctl(avr, AVR_IOCTL_EEPROM_SET, &all);
    fclose(file);
}

void device_save_eeprom(const char *path) {
    uint8_t content[EEPROM_BYTES];
    avr_eeprom_desc_t all = {.ee = content, .size = sizeof content};
    avr_ioctl(avr, AVR_IOCTL_EEPROM_GET, &all);
    FILE *file = fopen(path, "wb");
    if (file == NULL || fwrite(content, 1, sizeof content, file) != sizeof content || fclose(file) != 0) fail(path);
}
