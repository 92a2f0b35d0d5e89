/* ADS131M04: four simultaneous 24-bit channels on SPI, 4000 samples per second, gain 128.
 *
 * Source: Texas Instruments, data sheet SBAS890 (interface, registers). Up to four chips share clock,
 * data and CLKIN, each with a chip select of its own.
 */
#ifndef ADS131M04_H
#define ADS131M04_H

#include "node.h"

enum { ADS_CHANNELS = 4, ADS_CHIPS = 4, ADS_FRAME = 18 };

struct ads131m04 {
    /* Transfer a whole frame of one chip: chip select, 18 bytes both ways, SPI mode 1, at most 25 MHz. */
    void (*transfer)(void *context, uint8_t chip, const uint8_t *out, uint8_t *in);
    void *context;
    uint8_t chips;
    bool ready[ADS_CHIPS];   /* set up and read back */
};

/* Write and read back the settings of a chip. Returns false if it does not answer or keeps other settings. */
bool ads131m04_setup(struct ads131m04 *adc, uint8_t chip);

/* Read the newest conversion of each channel. A chip that has been reset is set up again. Its readings are
 * not valid until then. The signature is that of ``node_board.read`` with the ADC as context. */
void ads131m04_read(void *adc, struct node_reading *readings, uint8_t channels);

#endif
