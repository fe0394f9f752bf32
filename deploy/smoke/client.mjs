// A client in Node.js, made of the .proto files alone: lists the robots, plans a motion, and prints the verdict.
//     node client.mjs HOST:PORT [CA.pem TOKEN_FILE]
import {readFileSync} from "node:fs";
import {fileURLToPath} from "node:url";
import grpc from "@grpc/grpc-js";
import {loadSync} from "@grpc/proto-loader";

const [target = "localhost:50051", authority, tokenFile] = process.argv.slice(2);
const folder = fileURLToPath(new URL("../../service/proto", import.meta.url));
const definition = loadSync("planner/v1/planner.proto", {includeDirs: [folder], keepCase: true, enums: String, longs: Number});
const {PlannerService} = grpc.loadPackageDefinition(definition).planner.v1;

let credentials = grpc.credentials.createInsecure();
if (authority) {
  const token = readFileSync(tokenFile, "utf8").trim();
  const identity = grpc.credentials.createFromMetadataGenerator((_, done) => {
    const metadata = new grpc.Metadata();
    metadata.set("authorization", `Bearer ${token}`);
    done(null, metadata);
  });
  credentials = grpc.credentials.combineChannelCredentials(grpc.credentials.createSsl(readFileSync(authority)), identity);
}
const client = new PlannerService(target, credentials, {"grpc.max_receive_message_length": -1});

const robots = await new Promise((resolve, reject) => {
  client.ListRobots({}, {deadline: Date.now() + 30_000}, (error, answer) => (error ? reject(error) : resolve(answer.robots)));
});
console.log("robots:", robots.map((robot) => robot.name).join(", "));

const request = {robot: {name: "atlas"}, start: {posture: "stand"}, goal: {joints: {l_arm_elx: 1.2}}};
const call = client.Plan({request}, {deadline: Date.now() + 120_000});
let result;
for await (const event of call) {
  if (event.progress && !event.progress.iteration) console.log(`${Math.round(100 * event.progress.fraction)} %`, event.progress.step);
  if (event.finished) result = event.finished.result;
}
const {joint_names: names, times, positions} = result.trajectory;
const elbow = positions[positions.length - names.length + names.indexOf("l_arm_elx")];
console.log(result.verdict, `${times.length} samples, l_arm_elx ends at ${elbow.toFixed(3)} rad`);
client.close();
process.exit(result.verdict === "VERDICT_CERTIFIED" ? 0 : 1);
