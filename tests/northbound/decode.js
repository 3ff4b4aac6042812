// Decodes Sparkplug B payloads by the package sparkplug-payload: a line of hexadecimal in, a line of JSON out.
const payload = require("sparkplug-payload").get("spBv1.0");
const seen = (_key, value) => (typeof value === "bigint" ? Number(value) : value);
require("readline").createInterface({ input: process.stdin }).on("line", (line) => {
    const found = payload.decodePayload(Buffer.from(line, "hex"));
    const plain = JSON.parse(JSON.stringify(found, (key, value) =>
        value && value.low !== undefined && value.high !== undefined
            ? Number(BigInt(value.high >>> 0) << 32n | BigInt(value.low >>> 0)) : seen(key, value)));
    console.log(JSON.stringify(plain));
});
