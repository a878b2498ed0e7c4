// Reads messages of OpenIGTLink on standard input with the reference library, checks them, and
// writes each again, packed anew by the library, after a line of what was read.
#include <cstdio>
#include <cstring>
#include <string>
#include <vector>

#include "igtlImageMessage.h"
#include "igtlMessageHeader.h"
#include "igtlPointMessage.h"
#include "igtlPolyDataMessage.h"
#include "igtlPositionMessage.h"
#include "igtlStatusMessage.h"
#include "igtlStringMessage.h"
#include "igtlTrajectoryMessage.h"
#include "igtlTransformMessage.h"

static bool take(void *to, size_t n) { return std::fread(to, 1, n, stdin) == n; }

template <class M> static typename M::Pointer unpacked(igtl::MessageHeader::Pointer header) {
    typename M::Pointer message = M::New();
    message->SetMessageHeader(header);
    message->AllocatePack();
    const size_t size = message->GetPackBodySize();
    if (!take(message->GetPackBodyPointer(), size)) {
        std::fprintf(stderr, "%s: no body of %zu bytes\n", header->GetDeviceType(), size);
        std::exit(2);
    }
    if (!(message->Unpack(1) & igtl::MessageHeader::UNPACK_BODY)) {
        std::fprintf(stderr, "%s: not taken\n", header->GetDeviceType());
        std::exit(2);
    }
    return message;
}

static void again(igtl::MessageBase *message) {
    message->Pack();
    const unsigned size = message->GetPackSize();
    const unsigned char length[4] = {(unsigned char)(size >> 24), (unsigned char)(size >> 16),
                                     (unsigned char)(size >> 8), (unsigned char)size};
    std::fwrite(length, 1, 4, stdout);
    std::fwrite(message->GetPackPointer(), 1, size, stdout);
}

int main() {
    for (;;) {
        igtl::MessageHeader::Pointer header = igtl::MessageHeader::New();
        header->InitPack();
        if (!take(header->GetPackPointer(), header->GetPackSize()))
            return 0;
        header->Unpack();
        const std::string kind = header->GetDeviceType();
        std::printf("%s %s", kind.c_str(), header->GetDeviceName());
        if (kind == "TRANSFORM") {
            auto message = unpacked<igtl::TransformMessage>(header);
            igtl::Matrix4x4 m;
            message->GetMatrix(m);
            for (int i = 0; i < 3; i++)
                for (int j = 0; j < 4; j++)
                    std::printf(" %g", m[i][j]);
            std::printf("\n");
            again(message);
        } else if (kind == "POSITION") {
            auto message = unpacked<igtl::PositionMessage>(header);
            float p[3], q[4];
            message->GetPosition(p);
            message->GetQuaternion(q);
            std::printf(" %g %g %g %g %g %g %g\n", p[0], p[1], p[2], q[0], q[1], q[2], q[3]);
            again(message);
        } else if (kind == "POINT") {
            auto message = unpacked<igtl::PointMessage>(header);
            for (int i = 0; i < message->GetNumberOfPointElement(); i++) {
                igtl::PointElement::Pointer point;
                message->GetPointElement(i, point);
                float p[3];
                point->GetPosition(p);
                std::printf(" %s %g %g %g", point->GetName(), p[0], p[1], p[2]);
            }
            std::printf("\n");
            again(message);
        } else if (kind == "TRAJ") {
            auto message = unpacked<igtl::TrajectoryMessage>(header);
            for (int i = 0; i < message->GetNumberOfTrajectoryElement(); i++) {
                igtl::TrajectoryElement::Pointer path;
                message->GetTrajectoryElement(i, path);
                float a[3], b[3];
                path->GetEntryPosition(a);
                path->GetTargetPosition(b);
                std::printf(" %s %d %g %g %g %g %g %g", path->GetName(), path->GetType(), a[0],
                            a[1], a[2], b[0], b[1], b[2]);
            }
            std::printf("\n");
            again(message);
        } else if (kind == "POLYDATA") {
            auto message = unpacked<igtl::PolyDataMessage>(header);
            std::printf(" %d", message->GetPoints()->GetNumberOfPoints());
            for (unsigned i = 0; i < message->GetLines()->GetNumberOfCells(); i++)
                std::printf(" %u", message->GetLines()->GetCellSize(i));
            std::printf("\n");
            again(message);
        } else if (kind == "IMAGE") {
            auto message = unpacked<igtl::ImageMessage>(header);
            int n[3];
            float origin[3], spacing[3];
            message->GetDimensions(n);
            message->GetOrigin(origin);
            message->GetSpacing(spacing);
            unsigned sum = 0;
            const unsigned char *pixels = (const unsigned char *)message->GetScalarPointer();
            for (int i = 0; i < message->GetImageSize(); i++)
                sum += pixels[i];
            std::printf(" %d %d %d %d %d %g %g %g %g %g %g %u\n", n[0], n[1], n[2],
                        message->GetNumComponents(), message->GetCoordinateSystem(), origin[0],
                        origin[1], origin[2], spacing[0], spacing[1], spacing[2], sum);
            again(message);
        } else if (kind == "STATUS") {
            auto message = unpacked<igtl::StatusMessage>(header);
            std::printf(" %d %lld %s %s\n", message->GetCode(), (long long)message->GetSubCode(),
                        message->GetErrorName(), message->GetStatusString());
            again(message);
        } else if (kind == "STRING") {
            auto message = unpacked<igtl::StringMessage>(header);
            std::printf(" %d %s\n", message->GetEncoding(), message->GetString());
            again(message);
        } else {
            std::fprintf(stderr, "%s: not known here\n", kind.c_str());
            return 2;
        }
    }
}
