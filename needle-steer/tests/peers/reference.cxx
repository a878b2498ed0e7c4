// Watches and commands a run with the reference library of OpenIGTLink. The argument is the port.
// Prints "passed" at the end.
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <map>
#include <string>

#include "igtlClientSocket.h"
#include "igtlMessageHeader.h"
#include "igtlPositionMessage.h"
#include "igtlStatusMessage.h"
#include "igtlStringMessage.h"
#include "igtlTrajectoryMessage.h"
#include "igtlTransformMessage.h"

static igtl::ClientSocket::Pointer peer;
// What came, by type and name, in words.
static std::map<std::string, std::string> seen;

static void fail(const std::string &what) {
    std::fprintf(stderr, "%s\n", what.c_str());
    for (const auto &entry : seen)
        std::fprintf(stderr, "  %s: %s\n", entry.first.c_str(), entry.second.c_str());
    std::exit(1);
}

template <class M> static typename M::Pointer body(igtl::MessageHeader::Pointer header) {
    typename M::Pointer message = M::New();
    message->SetMessageHeader(header);
    message->AllocatePack();
    const int size = message->GetPackBodySize();
    if (peer->Receive(message->GetPackBodyPointer(), size) != size)
        fail("a body cut short");
    if (!(message->Unpack(1) & igtl::MessageHeader::UNPACK_BODY))
        fail("a body that is not taken");
    return message;
}

// Takes one message.
static void look() {
    igtl::MessageHeader::Pointer header = igtl::MessageHeader::New();
    header->InitPack();
    if (peer->Receive(header->GetPackPointer(), header->GetPackSize()) != header->GetPackSize())
        fail("no header");
    header->Unpack();
    const std::string kind = header->GetDeviceType();
    const std::string key = kind + " " + header->GetDeviceName();
    char words[4096] = "";
    if (kind == "TRANSFORM") {
        igtl::Matrix4x4 m;
        body<igtl::TransformMessage>(header)->GetMatrix(m);
        std::snprintf(words, sizeof words, "%.1f %.1f %.1f", m[0][3], m[1][3], m[2][3]);
    } else if (kind == "POSITION") {
        float p[3];
        body<igtl::PositionMessage>(header)->GetPosition(p);
        std::snprintf(words, sizeof words, "%.1f %.1f %.1f", p[0], p[1], p[2]);
    } else if (kind == "STRING") {
        std::snprintf(words, sizeof words, "%s", body<igtl::StringMessage>(header)->GetString());
    } else if (kind == "STATUS") {
        auto status = body<igtl::StatusMessage>(header);
        std::snprintf(words, sizeof words, "%d %s", status->GetCode(), status->GetErrorName());
    } else if (kind == "TRAJ") {
        auto path = body<igtl::TrajectoryMessage>(header);
        igtl::TrajectoryElement::Pointer element;
        path->GetTrajectoryElement(0, element);
        float p[3];
        element->GetTargetPosition(p);
        std::snprintf(words, sizeof words, "%.1f %.1f %.1f", p[0], p[1], p[2]);
    } else {
        peer->Skip(header->GetBodySizeToRead(), 0);
    }
    seen[key] = words;
}

// Waits until `key` has come with `words` in it.
static void wait(const std::string &key, const std::string &words) {
    for (int i = 0; i < 20000; i++) {
        const auto found = seen.find(key);
        if (found != seen.end() && found->second.find(words) != std::string::npos)
            return;
        look();
    }
    fail("no " + key + " with " + words);
}

static void say(const char *text) {
    seen.erase("STRING Answer");
    igtl::StringMessage::Pointer message = igtl::StringMessage::New();
    message->SetDeviceName("Command");
    message->SetString(text);
    message->Pack();
    peer->Send(message->GetPackPointer(), message->GetPackSize());
    wait("STRING Answer", "");
}

int main(int, char **arguments) {
    peer = igtl::ClientSocket::New();
    if (peer->ConnectToServer("127.0.0.1", std::atoi(arguments[1])) != 0)
        fail("no connection");
    wait("TRANSFORM NeedleTip", "400.0 ");
    wait("POSITION TipPosition", "400.0 ");
    wait("STATUS NeedleSteer", "13 Idle");
    say("NONSENSE");
    wait("STRING Answer", "\"accepted\":false");

    seen.erase("STRING Answer");
    igtl::Matrix4x4 matrix;
    igtl::IdentityMatrix(matrix);
    matrix[0][3] = 402;
    matrix[2][3] = 190;
    igtl::TransformMessage::Pointer target = igtl::TransformMessage::New();
    target->SetDeviceName("NewTarget");
    target->SetMatrix(matrix);
    target->Pack();
    peer->Send(target->GetPackPointer(), target->GetPackSize());
    wait("STRING Answer", "60.0 mm ahead");

    say("START");
    wait("STRING Answer", "\"accepted\":true");
    wait("TRANSFORM Target", "402.0 ");
    wait("TRAJ Plan", "402.0 ");
    wait("STATUS NeedleSteer", "1 ");
    say("STOP");
    wait("STRING Answer", "\"accepted\":true");
    std::puts("passed");
    return 0;
}
