"""Cameras of another make: republishes left/ and right/image_raw under other/ in another form.

Argument: bgr8, mono16, padded, compressed (PNG), late (the right stamps by 6 ms), or the name of an
encoding that is put on the images as they are. Says "ready" on standard output.
"""
import struct
import sys
import zlib

import rospy
from sensor_msgs.msg import CompressedImage, Image

form = sys.argv[1]
PADDING = 16


def png(image):
    """The grey image as a PNG."""
    def chunk(name, data):
        check = struct.pack('>I', zlib.crc32(name + data))
        return struct.pack('>I', len(data)) + name + data + check
    header = struct.pack('>2I5B', image.width, image.height, 8, 0, 0, 0, 0)
    rows = (image.data[y * image.width:(y + 1) * image.width] for y in range(image.height))
    pixels = zlib.compress(b''.join(b'\0' + row for row in rows), 1)
    return (b'\x89PNG\r\n\x1a\n' + chunk(b'IHDR', header) + chunk(b'IDAT', pixels)
            + chunk(b'IEND', b''))


def changed(image, side):
    if form == 'compressed':
        return CompressedImage(header=image.header, format='mono8; png compressed mono8',
                               data=png(image))
    data, out = image.data, Image(header=image.header, height=image.height, width=image.width)
    out.encoding, out.step = image.encoding, image.width
    if form == 'bgr8':
        pixels = bytearray(3 * len(data))
        for channel in range(3):
            pixels[channel::3] = data
        data, out.encoding, out.step = bytes(pixels), form, 3 * image.width
    elif form == 'mono16':
        # 12 bits, the lower byte first.
        pixels = bytearray(2 * len(data))
        pixels[0::2] = data.translate(bytes((16 * v) % 256 for v in range(256)))
        pixels[1::2] = data.translate(bytes(v // 16 for v in range(256)))
        data, out.encoding, out.step = bytes(pixels), form, 2 * image.width
    elif form == 'padded':
        rows = (data[y * image.width:(y + 1) * image.width] for y in range(image.height))
        data = b''.join(row + bytes(PADDING) for row in rows)
        out.encoding, out.step = '8UC1', image.width + PADDING
    elif form == 'late':
        if side == 'right':
            out.header.stamp = image.header.stamp + rospy.Duration(0.006)
    else:
        out.encoding = form
    out.data = data
    return out


rospy.init_node('other_cameras')
for side in ('left', 'right'):
    topic, kind = '/other/%s/image_raw' % side, Image
    if form == 'compressed':
        topic, kind = topic + '/compressed', CompressedImage
    publisher = rospy.Publisher(topic, kind, queue_size=2)
    rospy.Subscriber('/%s/image_raw' % side, Image,
                     lambda image, side=side, publisher=publisher:
                     publisher.publish(changed(image, side)))
print('ready', flush=True)
rospy.spin()
