/* An SPI frame has six words of 24 bits. Sent: the command in the upper 16 bits of word 0, data in word 1. Received:
 * the answer to the previous command (STATUS after NULL), channels 0 to 3, and the CRC of these five words.
 *
 *     STATUS   bit 10: reset since the last write to MODE    bits 3..0: new conversion of channel 3..0
 *     WREG     011 aaaaaa nnnnnnn    RREG   101 aaaaaa nnnnnnn    a: address, n: number of registers minus one
 */
#include "ads131m04.h"

#include <string.h>

enum { MODE = 0x02, CLOCK = 0x03, GAIN = 0x04, NULL_COMMAND = 0x0000, WREG = 0x6000, RREG = 0xA000 };

static const uint16_t SETTINGS[][2] = {
    {CLOCK, 0x0F0E},   /* all channels on, oversampling 1024: 4 kSPS at 8.192 MHz, high resolution */
    {GAIN, 0x7777},    /* gain 128 on all channels: +-9.4 mV */
    {MODE, 0x0110},    /* words of 24 bits, SPI timeout on, reset flag cleared, last: later resets set the flag */
};
static const uint16_t RESET_FLAG = 1 << 10;

/* Return the CRC-16-CCITT of bytes, with the polynomial 0x1021 and the initial value 0xFFFF. */
static uint16_t crc_of(const uint8_t *bytes, uint8_t length) {
    uint16_t crc = 0xFFFF;
    for (uint8_t i = 0; i < length; i++) {
        crc = (uint16_t)(crc ^ bytes[i] << 8);
        for (int bit = 0; bit < 8; bit++) crc = (uint16_t)(crc & 0x8000 ? crc << 1 ^ 0x1021 : crc << 1);
    }
    return crc;
}

/* Exchange a frame with a chip. Returns false if the checksum of the answer is wrong, as it is without a chip. */
static bool exchange(struct ads131m04 *adc, uint8_t chip, uint16_t command, uint16_t value, uint8_t *in) {
    uint8_t out[ADS_FRAME] = {(uint8_t)(command >> 8), (uint8_t)command, 0, (uint8_t)(value >> 8), (uint8_t)value};
    adc->transfer(adc->context, chip, out, in);
    return crc_of(in, 15) == (uint16_t)(in[15] << 8 | in[16]);
}

bool ads131m04_setup(struct ads131m04 *adc, uint8_t chip) {
    uint8_t in[ADS_FRAME];
    adc->ready[chip] = false;
    for (uint8_t i = 0; i < sizeof SETTINGS / sizeof SETTINGS[0]; i++) {
        const uint16_t address = (uint16_t)(SETTINGS[i][0] << 7);
        const uint16_t value = SETTINGS[i][1];
        exchange(adc, chip, WREG | address, value, in);
        exchange(adc, chip, RREG | address, 0, in);
        /* The chip answers a command in the next frame. */
        if (!exchange(adc, chip, NULL_COMMAND, 0, in) || (in[0] << 8 | in[1]) != value) return false;
    }
    adc->ready[chip] = true;
    return true;
}

void ads131m04_read(void *context, struct node_reading *readings, uint8_t channels) {
    struct ads131m04 *adc = context;
    for (uint8_t chip = 0; chip < adc->chips && chip * ADS_CHANNELS < channels; chip++) {
        uint8_t in[ADS_FRAME];
        const bool answered = exchange(adc, chip, NULL_COMMAND, 0, in);
        const uint16_t status = (uint16_t)(in[0] << 8 | in[1]);
        const bool valid = answered && adc->ready[chip] && !(status & RESET_FLAG);
        for (uint8_t i = 0; i < ADS_CHANNELS && chip * ADS_CHANNELS + i < channels; i++) {
            const uint8_t *word = in + 3 * (i + 1);
            struct node_reading *reading = &readings[chip * ADS_CHANNELS + i];
            /* To extend the sign, the word is put in the upper 24 bits, and the arithmetic shift moves it back. */
            reading->counts = (int32_t)((uint32_t)word[0] << 24 | (uint32_t)word[1] << 16 | (uint32_t)word[2] << 8) >> 8;
            reading->valid = valid;
            reading->fresh = status >> i & 1;
        }
        if (!valid) ads131m04_setup(adc, chip);
    }
}
